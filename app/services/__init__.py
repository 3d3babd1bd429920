"""One use case a file. A service owns its transaction; here alone database, storage, vision and nutrition meet."""
