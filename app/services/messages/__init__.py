"""Sentences for participants in their language: sentences.toml holds them, catalogue.py reads them."""
