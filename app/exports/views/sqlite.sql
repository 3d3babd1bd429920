-- How a value is stored in SQLite: ids without hyphens, instants as UTC, lists and objects as JSON text.
CREATE MACRO id_text(id) AS id::UUID::VARCHAR;
CREATE MACRO as_utc(instant) AS instant;
