"""Lists of records, meals, photographs and changes: filtered JSON pages with cursors, or whole as files."""
