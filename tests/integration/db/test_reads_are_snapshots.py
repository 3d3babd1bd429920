"""What is read in several queries is of one moment: a page of changes, a meal with its records, a day."""

import uuid
from datetime import UTC, datetime

import pytest
import sqlalchemy as sa

from app.people.models import Study
from app.records import queries as records


@pytest.mark.both_stores
def test_second_query_of_a_read_sees_nothing_that_was_committed_since_the_first(database):
    study_id = uuid.uuid4()
    with database.write() as session:
        session.add(Study(id=study_id, code="pilot", name="pilot", change_seq=0, created_at=datetime.now(UTC)))
    seen = sa.select(Study.change_seq)
    with database.read() as reading:
        first = reading.scalars(seen).one()
        with database.write() as session:
            records.next_change_seq(session, study_id)
        assert reading.scalars(seen).one() == first
    with database.read() as session:
        assert session.scalars(seen).one() == first + 1
