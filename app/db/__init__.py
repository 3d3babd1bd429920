"""The database: sessions, models, and all SQL (queries/)."""
