"""Corrections in the database: what they leave as it is, what the constraints hold; `tada foods create, edit, ...`."""

import json

import pytest
import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from app.core.errors import InvalidInputError
from app.core.units import Unit
from app.db.session import Database
from app.foods import queries as foods
from app.foods.component_names import Figure
from app.foods.edits import edit_food
from app.foods.edits.edit_food import Editor, FoodEdit
from app.foods.foods import read_food
from app.foods.models import Food, FoodChange, FoodDensity, FoodNutrient, FoodRelease
from app.foods.search.search_foods import search_foods
from app.nutrition.foods import Density

EDITOR = Editor("a test", "to see")


@pytest.fixture
def database(prepared_database_url):
    database = Database(prepared_database_url)
    yield database
    database.dispose()


def correct(database, key, **fields):
    return edit_food.edit_food(database, key, FoodEdit(fields), EDITOR)


def imported_rows(database):
    """Everything that was imported, as it stands."""
    with database.read() as session:
        imported = sa.select(FoodRelease.id).where(FoodRelease.source != "local")
        food_ids = sa.select(Food.id).where(Food.release_id.in_(imported))
        tables = (
            (Food, Food.release_id.in_(imported)),
            (FoodNutrient, FoodNutrient.food_id.in_(food_ids)),
            (FoodDensity, FoodDensity.food_id.in_(food_ids)),
        )
        tables = ((model.__table__, where) for model, where in tables)
        return [
            session.execute(sa.select(*table.columns).where(where).order_by(*table.primary_key)).all()
            for table, where in tables
        ]


def test_no_imported_row_is_ever_changed(database):
    before = imported_rows(database)
    correct(database, "apple", name="ours")
    correct(database, "apple", name="ours again", densities=())
    edit_food.restore_food(database, "apple", 1, EDITOR)
    assert imported_rows(database) == before


@pytest.mark.both_stores
def test_each_version_is_kept_once_and_leads_to_the_next(database):
    for name in ("second", "third"):
        correct(database, "apple", name=name)
    correct(database, "apple", name="fourth", food_group="Ours")
    with database.read() as session:
        local = sa.select(FoodRelease.id).where(FoodRelease.source == "local").scalar_subquery()
        rows = session.scalars(sa.select(Food).where(Food.release_id == local).order_by(Food.version)).all()
        assert [(row.version, row.name) for row in rows] == [(2, "second"), (3, "third"), (4, "fourth")]
        assert [row.superseded_by_id for row in rows] == [rows[1].id, rows[2].id, None]
        previous = session.scalars(sa.select(FoodChange.previous_id).order_by(FoodChange.food_id)).all()
        assert previous[1:] == [rows[0].id, rows[1].id]
    newest = edit_food.list_changes(database, "apple")[0].change.differences  # as the API calls the fields
    assert newest == {"name": ["third", "fourth"], "group": ["Fruits and Fruit Juices", "Ours"]}
    columns = {column.name: getattr(rows[-1], column.name) for column in Food.__table__.columns if column.name != "id"}
    with database.write() as session, pytest.raises(IntegrityError):
        session.execute(sa.insert(Food), columns)


def test_search_and_the_number_in_a_published_table_find_the_correction_and_not_what_it_corrects(database):
    correct(database, "apple", name="Apple of our orchard")
    correct(database, "apple", name="Apple of our garden")
    found = [food for food in search_foods(database, "apple") if food.key == "apple"]
    assert [(food.name, food.release) for food in found] == [("Apple of our garden", "local 1")]
    assert [food.key for food in search_foods(database, "orchard")].count("apple") == 0
    assert len([food for food in search_foods(database, limit=1000) if food.key == "apple"]) == 1
    assert read_food(database, "09003").value.name == "Apple of our garden"
    assert correct(database, "09003", name="theirs").value.key == "apple"


@pytest.mark.both_stores
def test_a_figure_is_kept_in_the_component_s_unit_and_two_own_densities_of_one_source_are(database):
    figures = {"VITC": Figure(0.012, Unit.G), "268": Figure(100.0, Unit.KCAL)}
    edit_food.edit_food(database, "apple", FoodEdit(nutrients=figures), EDITOR)
    contents = read_food(database, "apple").value.per_100_g
    assert contents["401"] == pytest.approx(12.0)
    assert contents["268"] == pytest.approx(418.4)  # kJ; no table had brought the component yet
    for g_per_ml in (0.7, 0.8):
        density = Density(g_per_ml, 0.01, "raw", "solid", "measured", "our scale")
        edit_food.add_density(database, "apple", density, EDITOR)
    choice = read_food(database, "apple").density
    assert choice.chosen.g_per_ml == 0.8
    assert 0.7 in {other.density.g_per_ml for other in choice.alternatives}


@pytest.mark.both_stores
def test_a_correction_reaches_other_tables_foods_in_place_of_what_it_corrects(database):
    """The starter's apple lends its density to SR28's, which shares its number; corrected, it lends the correction."""
    twin = FoodEdit({"name": "twin", "food_group": "g", "form": "whole", "source_ids": {"sr28_ndb": "09003"}})
    edit_food.create_food(database, "twin", twin, EDITOR)
    assert "ECUSTFD" in read_food(database, "twin").density.chosen.source
    correct(database, "apple", densities=(Density(0.9, 0.1, "raw", "solid", "measured", "ours"),))
    choice = read_food(database, "twin").density
    assert choice.chosen.source == "ours"
    assert not any("ECUSTFD" in other.density.source for other in choice.alternatives)


@pytest.mark.both_stores
def test_a_row_of_a_table_of_densities_is_not_corrected_but_the_food_that_it_weighs(database):
    with database.write() as session:
        session.execute(sa.update(FoodRelease).where(FoodRelease.source == "starter").values(source="fao-density"))
    with pytest.raises(InvalidInputError) as caught:
        correct(database, "apple", name="x")
    assert caught.value.code == "food_has_densities_only"


def test_foods_are_made_and_corrected_from_the_command_line(tada, tmp_path):
    food = {"key": "quark", "name": "Quark", "group": "Dairy", "form": "in_vessel", "state": "as_eaten"}
    file = tmp_path / "quark.json"
    file.write_text(json.dumps(food | {"nutrients": {"ENERC_KCAL": {"per_100_g": 67, "unit": "kcal"}}}))
    without = tada("create", file)
    assert (without.returncode, "reason" in without.stderr) == (2, True)
    made = tada("create", file, "--reason", "for the pilot")
    assert (made.returncode, made.stderr) == (0, "")
    assert "quark: version 1 of local 1" in made.stdout
    edited = tada("edit", "quark", "--set", "name=Quark, low fat", "--set", "nutrients.208=null", "--reason", "better")
    assert (edited.returncode, edited.stderr) == (0, "")
    weighed = tada(
        "density", "quark", "--specimen", "100:104", "--specimen", "200:212", "--kind", "bulk", "--state", "as sold",
        "--method", "cup", "--reason", "weighed",
    )  # fmt: skip
    assert (weighed.returncode, weighed.stderr) == (0, "")
    shown = tada("show", "quark").stdout
    assert "1.050 +- " in shown
    assert "cup: median of 2 specimens" in shown
    changes = json.loads(tada("changes", "quark", "--json").stdout)["items"]
    assert [change["reason"] for change in changes] == ["weighed", "better", "for the pilot"]
    assert changes[1]["differences"] == {"name": ["Quark", "Quark, low fat"], "nutrients.208": [67.0, None]}
    assert changes[0]["author"].startswith("command line: ")
    back = tada("restore", "quark", "1", "--reason", "as it was")
    assert "quark: version 4" in back.stdout
    assert "better" in tada("changes", "quark").stdout


def test_wrong_use_is_told_in_a_sentence(tada, tmp_path):
    file = tmp_path / "broken.json"
    file.write_text("{")
    for arguments in (
        ("create", file),
        ("edit", "apple", "--reason", "r"),
        ("edit", "apple", "--set", "colour=red", "--reason", "r"),
        ("density", "apple", "--specimen", "x", "--kind", "solid", "--state", "s", "--method", "m", "--reason", "r"),
        ("restore", "apple", "7", "--reason", "r"),
    ):
        run = tada(*arguments)
        assert (run.returncode, run.stdout) == (2, ""), arguments
        assert run.stderr.startswith("tada: "), run.stderr
        assert run.stderr.count("\n") == 1
    assert "as it was imported" in tada("changes", "apple").stdout


def test_no_imported_table_takes_the_name_of_the_corrections(tada, tmp_path):
    file = tmp_path / "table.csv"
    file.write_text("key,name\n")
    run = tada("import", "csv", file, "--name", "local", "--version", "2", "--released-on", "2026-01-01")
    assert (run.returncode, "corrections" in run.stderr) == (2, True)


@pytest.mark.both_stores
def test_figures_that_came_impossible_may_be_corrected_one_by_one(database):
    edit = FoodEdit({"name": "n", "food_group": "g", "form": "whole"}, {"WATER": Figure(90.0, Unit.G)})
    edit_food.create_food(database, "ours", edit, EDITOR)
    with database.write() as session:  # as an import, which does not judge the sum, would have brought it
        session.execute(
            sa.update(FoodNutrient)
            .where(FoodNutrient.food_id == foods.foods_by_key(session, ["ours"])["ours"].id)
            .values(per_100_g=120.0)
        )
    vitamin = FoodEdit(nutrients={"VITC": Figure(5.0, Unit.MG)})
    assert edit_food.edit_food(database, "ours", vitamin, EDITOR).value.per_100_g == {"255": 120.0, "401": 5.0}
