"""The whole of SR28 in the database, against the release's own lines, on both kinds of database."""

import pytest
import sqlalchemy as sa

from app.db.models import Food, FoodNutrient
from app.db.session import Database
from app.nutrition.importers.sr28 import read_sr28
from app.services.foods import read_food
from app.services.import_foods import import_foods

FRUIT = ("09003", "09040", "09200", "09252", "09266", "09148")


@pytest.mark.slow
def test_foods_and_figures_are_those_of_the_release(prepared_database_url, shared_data, sr28_folder):
    database = Database(prepared_database_url)
    report = import_foods(database, read_sr28(shared_data / "food_tables" / "sr28asc.zip"), "me")
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
    again = import_foods(database, read_sr28(sr28_folder), "me")  # unpacked, it is the same release
    assert again.was_there
    database.dispose()
