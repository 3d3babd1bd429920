"""The columns of every table that leaves the server, with their meaning: what files and the data dictionary go by."""
