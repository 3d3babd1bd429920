"""Rows as files that others read: CSV, NDJSON, Parquet. Batches of columns in, bytes out; no database, no web."""
