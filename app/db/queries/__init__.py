"""All SQL, a file a subject: functions that take a session and return rows or values; they never commit."""
