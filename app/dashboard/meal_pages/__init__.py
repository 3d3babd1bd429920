"""Pages of meals and their review."""
