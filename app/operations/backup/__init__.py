"""`tada backup` and `tada restore`: a deployment in one file, verified before a restore."""
