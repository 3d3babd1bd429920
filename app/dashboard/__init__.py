"""The researchers' pages: the API's data as HTML, under the same rules. No SQL and no use cases."""
