"""Readers of published food tables, one per format: file -> validated values; errors name file and line."""
