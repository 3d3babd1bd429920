"""Readers of published food tables, one a format: file -> plain values, validated, with file and line in each error."""
