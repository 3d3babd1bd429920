"""`tada backup` and `tada restore`: a deployment in one file, verified completely before anything is restored."""
