"""The whole of SR28 in a database of each kind, against the release's own lines and as it is searched."""

import contextlib
import re

import pytest
import sqlalchemy as sa

from app.db.session import Database
from app.foods.foods import read_food
from app.foods.import_foods import import_foods, load_starter
from app.foods.importers.sr28 import read_sr28
from app.foods.models import Food, FoodNutrient
from app.foods.search.search_foods import search_foods
from tests.conftest import copied_database
from tests.support.food_queries import judged

FRUIT = ("09003", "09040", "09200", "09252", "09266", "09148")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["sqlite", "postgres"])
def imported(request, sr28_table, tmp_path_factory):
    """A database with SR28 alone, and what the import told: half a minute to make, so it is made once a kind."""
    with contextlib.ExitStack() as stack:
        folder = tmp_path_factory.mktemp("sr28-database")
        database = Database(stack.enter_context(copied_database(request, request.param, folder, "migrated")))
        stack.callback(database.dispose)
        yield database, import_foods(database, sr28_table, "me")


@pytest.fixture(scope="module")
def unpacked(sr28_folder):
    return read_sr28(sr28_folder)


def test_foods_and_figures_are_those_of_the_release(imported, unpacked, sr28_folder):
    database, report = imported
    lines = (sr28_folder / "NUT_DATA.txt").read_bytes().splitlines()
    assert (report.foods, report.values) == (8789, len(lines))
    with database.read() as session:
        release_id = session.scalars(sa.select(Food.release_id).where(Food.key == "sr28:09003")).one()
        assert session.scalar(sa.select(sa.func.count()).where(Food.release_id == release_id)) == 8789
        values = sa.select(sa.func.count()).select_from(FoodNutrient).join(Food).where(Food.release_id == release_id)
        assert session.scalar(values) == len(lines)
    published = {}
    for line in lines:
        ndb_number, number, content, *_ = (field.strip(b"~").decode() for field in line.split(b"^"))
        if ndb_number in FRUIT:
            published.setdefault(ndb_number, {})[number] = float(content)
    for ndb_number in FRUIT:
        assert read_food(database, f"sr28:{ndb_number}").value.per_100_g == published[ndb_number]
    assert {number: published["09003"][number] for number in ("208", "205")} == {"208": 52.0, "205": 13.81}
    assert published["09040"]["208"] == 89.0
    assert import_foods(database, unpacked, "me").was_there  # unpacked, it is the same release


def test_judged_queries_find_what_a_person_expects(imported):
    """Puts the starter table beside SR28: stands last."""
    database, _ = imported
    alone = judge(database)
    load_starter(database)
    both = judge(database)
    assert search_foods(database, "apple")[0].key == "apple"
    assert (alone["first"], alone["three"]) >= (0.85, 0.95)
    assert (both["first"], both["three"]) >= (0.9, 0.97)


def judge(database):
    hits = []
    for row in judged():
        found = search_foods(database, row["query"], limit=3)
        hits.append([bool(re.search(row["first"], food.name, re.IGNORECASE)) for food in found])
    first, three = sum(any(hit[:1]) for hit in hits), sum(any(hit) for hit in hits)
    return {"first": first / len(hits), "three": three / len(hits)}
