"""Packaged foods by barcode: Open Food Facts' dump in a table of its own, and those that were eaten as foods."""
