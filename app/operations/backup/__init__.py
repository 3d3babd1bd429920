"""`tada backup` and `tada restore`: a deployment in one file, checked whole before anything is restored from it."""
