"""The researchers' pages: HTML of what the API tells, under the same rules; all SQL and all use cases are elsewhere."""
