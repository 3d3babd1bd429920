-- How a value is stored in PostgreSQL: ids as UUID, instants with a time zone.
CREATE MACRO id_text(id) AS id::VARCHAR;
CREATE MACRO as_utc(instant) AS instant AT TIME ZONE 'UTC';
