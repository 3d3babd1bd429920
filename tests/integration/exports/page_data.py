"""Studies, foods and people whose pages are read, and the database's plan of a page."""

import uuid
from datetime import UTC, date, datetime

import sqlalchemy as sa

from app.foods.models import Food, FoodRelease
from app.people.models import Device, Participant, Study

NOW = datetime(2026, 11, 1, tzinfo=UTC)
FIRST_DAY = date(2026, 10, 1)
FOODS = {None: None, 10: "apple", 11: "pear", 20: "apple", 21: "pear"}


def lay_ground(session, drawn):
    """Foods in two releases; yields (study, person, device) of three studies, two people each, one code in all."""
    for number in (1, 2):
        session.add(FoodRelease(id=number, source="test", name="table", version=str(number), released_on=FIRST_DAY,
                                checksum=str(number) * 64, imported_at=NOW, completed_at=NOW))  # fmt: skip
        session.flush()
        for food, key in enumerate(("apple", "pear")):
            session.add(Food(id=10 * number + food, release_id=number, key=key, name=key, aliases=[],
                             food_group="all", form="ball", refuse=[], probes=[], source_ids={}))  # fmt: skip
    for study_code in ("a", "b", "c"):
        study = Study(id=some_id(drawn), code=study_code, name=study_code, created_at=NOW)
        session.add(study)
        session.flush()
        for code in ("P001", f"P-{study_code}"):
            person = Participant(id=some_id(drawn), study_id=study.id, code=code, created_at=NOW)
            device = Device(id=some_id(drawn), participant_id=person.id, name="phone", enrolled_at=NOW)
            for row in (person, device):
                session.add(row)
                session.flush()
            yield study, person, device


def some_id(drawn):
    return uuid.UUID(int=drawn.getrandbits(128))


def plan_of(session, query):
    """The database's plan, where it may not sort and not read whole tables if it can do without."""
    statement = query.compile(session.connection().engine, compile_kwargs={"render_postcompile": True})
    if session.connection().dialect.name == "sqlite":
        rows = session.connection().exec_driver_sql(
            f"EXPLAIN QUERY PLAN {statement}", tuple(_stored(statement, name) for name in statement.positiontup)
        )
        return [row[-1] for row in rows]
    for name in ("enable_seqscan", "enable_sort", "enable_incremental_sort", "enable_bitmapscan"):
        session.execute(sa.text(f"SET LOCAL {name} = off"))
    rows = session.connection().exec_driver_sql(
        f"EXPLAIN (COSTS OFF) {statement}", {name: _stored(statement, name) for name in statement.params}
    )
    return [row[0].strip() for row in rows]


def _stored(statement, name):
    value = statement.params[name]
    process = statement._bind_processors.get(name)
    return process(value) if process else value
