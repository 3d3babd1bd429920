"""Sentences for participants in four languages, and the code that reads them (catalogue.py)."""
