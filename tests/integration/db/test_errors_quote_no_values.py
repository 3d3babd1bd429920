"""What a database refuses is about people: its errors end up in logs, so they quote none of it."""

import traceback
import uuid
from datetime import UTC, datetime

import pytest
import sqlalchemy as sa

from app.people.models import Study

MARK = "value-of-a-person-7Lp"


def add_study(session, code=MARK):
    session.add(Study(id=uuid.uuid4(), code=code, name=MARK, created_at=datetime.now(UTC)))


STATEMENTS = (
    "INSERT INTO study SELECT * FROM study",  # a key that is taken
    "UPDATE study SET name = NULL",  # a column that may not be empty: PostgreSQL quotes the whole row
    "UPDATE study SET locale = 'xx', location_policy = 'nowhere'",  # a check: likewise
    "SELECT CAST(name AS integer) / 0 FROM study",
)


@pytest.mark.both_stores
def test_refusal_quotes_no_value_and_names_the_table_whose_constraint_it_is(database):
    with database.write() as session:
        add_study(session)
    for statement in STATEMENTS:
        text = ""
        try:
            with database.write() as session:
                session.execute(sa.text(statement))
        except sa.exc.DBAPIError as error:
            text = "".join(traceback.format_exception(error))
        assert text or database.is_sqlite, statement  # SQLite casts and divides without a word
        assert database.is_sqlite or "SQLSTATE" in text, statement
        assert MARK not in text, statement
    with pytest.raises(sa.exc.IntegrityError) as caught, database.write() as session:
        add_study(session)
    text = "".join(traceback.format_exception(caught.value))
    assert MARK not in text
    assert "study" in text
