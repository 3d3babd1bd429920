"""A published table goes in whole or not at all, as often as one likes, beside others, and out again."""

import dataclasses
import threading
from datetime import date, timedelta

import pytest
import sqlalchemy as sa

from app.core.errors import ConflictError, NotFoundError
from app.db.session import Database
from app.foods import import_foods as module
from app.foods.food_releases import list_releases, use_release
from app.foods.foods import read_food
from app.foods.import_foods import import_foods
from app.foods.importers.source_files import ImportedTable, Skipped
from app.foods.models import Food, FoodActivation, FoodNutrient, FoodRelease
from app.foods.search.models import FoodPosting
from app.nutrition.components import COMPONENT_BY_NUMBER
from app.nutrition.foods import Density, FoodTable, RefusePart
from app.nutrition.foods import Food as FoodValue
from app.nutrition.portions import Portion


def food(number, energy=50.0, **changes):
    value = FoodValue(
        key=f"bls:{number}",
        name=f"Quince number {number}",
        aliases=(f"Quitte {number}",),
        food_group="Fruits",
        form="whole",
        slice_form=None,
        refuse=(RefusePart("core", 10.0),),
        densities=(Density(0.9, 0.05, "raw", "solid", "measured", f"a quince, {number}"),),
        per_100_g={"208": energy, "401": 15.0},
        source_ids={"bls": str(number)},
        portions=(Portion("1", 1.0, "piece", 120.0),),
    )
    return dataclasses.replace(value, **changes)


def table(count=250, version="1", **changes):
    foods = tuple(food(number, **changes) for number in range(count))
    return table_of(*foods, version=version, checksum=f"{version}-{count}-{changes}".ljust(64, "x")[:64])


def table_of(*foods, name="bls", kind="csv", version="1", checksum="s" * 64):
    components = (COMPONENT_BY_NUMBER["208"], COMPONENT_BY_NUMBER["401"])
    return ImportedTable(kind, FoodTable(name, version, date(2026, 1, 1), checksum, foods), components, Skipped())


def counts(database):
    with database.read() as session:
        return {
            model.__tablename__: session.scalar(sa.select(sa.func.count()).select_from(model))
            for model in (FoodRelease, FoodActivation, Food, FoodNutrient, FoodPosting)
        }


@pytest.fixture
def database(prepared_database_url):
    database = Database(prepared_database_url)
    yield database
    database.dispose()


class Stop(Exception):  # noqa: N818
    pass


def stop_after(foods):
    def tell(written, _):
        if written >= foods:
            raise Stop

    return tell


def test_imported_foods_are_in_force_with_all_that_belongs_to_them(database):
    report = import_foods(database, table(), "me")
    assert (report.foods, report.values, report.was_there) == (250, 500, False)
    view = read_food(database, "bls:7")
    assert view.value == dataclasses.replace(food(7), per_100_g=view.value.per_100_g)
    assert dict(view.value.per_100_g) == {"208": 50.0, "401": 15.0}
    assert view.release == "bls 1"
    assert read_food(database, "7").value.key == "bls:7"  # by its number in the table


@pytest.mark.both_stores
def test_importing_twice_changes_nothing(database):
    import_foods(database, table(), "me")
    before = counts(database)
    assert import_foods(database, table(), "me").was_there
    assert counts(database) == before


def test_broken_off_import_is_seen_by_nobody_and_goes_on_where_it_stopped(database):
    before = counts(database)
    with pytest.raises(Stop):
        import_foods(database, table(), "me", stop_after(100))
    with pytest.raises(NotFoundError):
        read_food(database, "bls:7")
    with pytest.raises(NotFoundError, match="no complete release bls 1"):
        use_release(database, "bls", "1", "me")
    assert counts(database)["food_activation"] == before["food_activation"]
    written = []
    report = import_foods(database, table(), "me", lambda done, _: written.append(done))
    assert written == [150, 200, 250]
    assert not report.was_there
    assert counts(database)["food"] == before["food"] + 250
    assert read_food(database, "bls:249").value.name == "Quince number 249"


def test_import_whose_process_was_killed_is_taken_up_after_a_time(database, monkeypatch):
    monkeypatch.setattr(module, "_release_import", lambda *_: None)  # a killed process releases nothing
    with pytest.raises(Stop):
        import_foods(database, table(), "me", stop_after(100))
    with pytest.raises(ConflictError, match="another process"):
        import_foods(database, table(), "me")
    monkeypatch.setattr(module, "ABANDONED_AFTER", timedelta(0))
    assert not import_foods(database, table(), "me").was_there
    with database.read() as session:
        assert session.scalar(sa.select(sa.func.count()).where(Food.key.like("bls:%"))) == 250


@pytest.mark.both_stores
def test_importer_that_was_thought_dead_writes_no_more(database, monkeypatch):
    monkeypatch.setattr(module, "ABANDONED_AFTER", timedelta(0))
    finished = []

    def overtaken(written, _):
        if written == 100:
            finished.append(import_foods(database, table(), "the second"))

    with pytest.raises(ConflictError, match="taken over"):
        import_foods(database, table(), "the first", overtaken)
    assert finished[0].foods == 250
    with database.read() as session:
        keys = session.scalars(sa.select(Food.key).where(Food.key.like("bls:%"))).all()
    assert len(keys) == len(set(keys)) == 250


@pytest.mark.both_stores
def test_two_imports_at_once_leave_one_table(database):
    outcomes = []

    def run():
        try:
            outcomes.append(import_foods(database, table(), "me").was_there)
        except ConflictError as error:
            outcomes.append(error.code)

    threads = [threading.Thread(target=run) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(outcomes) == 3
    assert outcomes.count(False) == 1  # the others were told, or came when all was done
    with database.read() as session:
        assert session.scalar(sa.select(sa.func.count()).where(Food.key.like("bls:%"))) == 250


def test_new_release_of_a_table_takes_the_place_of_the_old_one_and_back(database):
    import_foods(database, table(energy=50.0), "me")
    import_foods(database, table(version="2", energy=60.0), "me")
    assert read_food(database, "bls:7").value.per_100_g["208"] == 60.0
    use_release(database, "bls", "1", "me")
    assert read_food(database, "bls:7").value.per_100_g["208"] == 50.0
    use_release(database, "bls", None, "me")
    with pytest.raises(NotFoundError):
        read_food(database, "bls:7")
    states = {
        (one.release.name, one.release.version): (one.release.completed_at is not None, one.is_in_force)
        for one in list_releases(database)
    }
    assert states["bls", "1"] == states["bls", "2"] == (True, False)
    assert ("tada-starter", True) in {(one.release.name, one.is_in_force) for one in list_releases(database)}


@pytest.mark.both_stores
def test_foods_of_one_data_set_and_class_take_no_densities_from_each_other_and_are_not_found_by_it(database):
    shared = {"fdc_data_type": "sr_legacy_food", "foodex2": "A01DJ"}
    foods = (food(number, source_ids={"fdc_id": f"17168{number}"} | shared) for number in range(3))
    import_foods(database, table_of(*foods), "me")
    assert [density.source for density in read_food(database, "bls:1").value.densities] == ["a quince, 1"]
    assert read_food(database, "171681").value.key == "bls:1"
    with pytest.raises(NotFoundError):
        read_food(database, "sr_legacy_food")


def test_starters_judgement_stands_for_what_the_tables_that_it_is_made_from_say(database):
    """SR28's cup of milk would come back behind a density that the starter's selection put in its place."""
    cup = Density(2.0, 0.1, "raw", "solid", "portion", "USDA SR28, a cup that cannot be")
    heap = Density(0.7, 0.1, "chopped", "bulk", "portion", "USDA SR28, a heap that the starter does not know")
    milk = food(1, key="sr28:01077", source_ids={"sr28_ndb": "01077"}, form="liquid", densities=(cup, heap))
    import_foods(database, table_of(milk, name="sr28", kind="sr28"), "me")
    ours, theirs = read_food(database, "milk-whole").value, read_food(database, "sr28:01077").value
    assert cup not in (*ours.densities, *theirs.densities)
    assert heap in ours.densities
    assert heap in theirs.densities
    assert read_food(database, "sr28:01077").density.chosen == read_food(database, "milk-whole").density.chosen


@pytest.mark.both_stores
def test_density_row_of_the_same_name_is_linked_if_its_state_is_known_to_be_the_same(database):
    fruits = {"quince": "as_eaten", "pear": "raw", "plum": None}
    jams = (
        food(number, name=f"Jam, {fruit}", aliases=(), densities=(), state="as_eaten")
        for number, fruit in enumerate(fruits)
    )
    import_foods(database, table_of(*jams), "me")
    measured = (Density(1.33, 0.1, "as eaten", "solid", "fao", "a row of FAO"),)
    rows = (
        food(fruit, name=f"{fruit.title()} jam", aliases=(), per_100_g={}, state=state, densities=measured)
        for fruit, state in fruits.items()
    )
    rows = (dataclasses.replace(row, key=f"fao:{number}") for number, row in enumerate(rows))
    import_foods(database, table_of(*rows, name="fao-infoods-density", kind="fao-density", checksum="f" * 64), "me")
    choices = [read_food(database, f"bls:{number}").density for number in range(3)]
    assert [choice is not None and choice.chosen.g_per_ml == 1.33 for choice in choices] == [True, False, False]
