"""Messages for participants in four languages (TOML files), and the code that reads them (catalogue.py)."""
