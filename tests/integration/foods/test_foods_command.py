"""`tada foods import` as a person types it: what is wrong is named with file and line, and nothing is written."""

import json
import zipfile

import pytest
import sqlalchemy as sa

from app.db.session import Database
from app.foods.models import Food, FoodActivation, FoodNutrient, FoodRelease

APPLE = {
    "FD_GROUP.txt": "~0900~^~Fruits and Fruit Juices~\r\n",
    "NUTR_DEF.txt": "~208~^~kcal~^~ENERC_KCAL~^~Energy~^~0~^~300~\r\n~203~^~g~^~PROCNT~^~Protein~^~2~^~600~\r\n",
    "FOOD_DES.txt": "~09003~^~0900~^~Apples, raw, with skin~^~APPLES~^^^~Y~^~Core and stem~^10^^^3.36^8.37^3.60\r\n",
    "NUT_DATA.txt": (
        "~09003~^~208~^52^0^^~4~^~NC~^^^^^^^^^^^08/2008\r\n~09003~^~203~^0.26^0^^~1~^^^^^^^^^^^^08/2008\r\n"
    ),
    "WEIGHT.txt": "~09003~^1^1^~cup slices~^109^^\r\r\n",
}


@pytest.fixture
def counts(prepared_database_url):
    def count():
        database = Database(prepared_database_url)
        with database.read() as session:
            found = [
                session.scalar(sa.select(sa.func.count()).select_from(model))
                for model in (FoodRelease, FoodActivation, Food, FoodNutrient)
            ]
        database.dispose()
        return found

    return count


def release(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in APPLE.items():
            archive.writestr(f"sr28asc/{name}", text.encode("cp1252"))
    return path


def test_release_is_imported_shown_and_found(tada, tmp_path, counts):
    done = tada("import", "sr28", release(tmp_path / "sr28.zip"))
    assert (done.returncode, done.stderr.splitlines()[-1]) == (0, "  1 of 1 foods written")
    assert "sr28 28: 1 foods, 2 nutrient values, imported and in force" in done.stdout
    shown = json.loads(tada("show", "sr28:09003", "--json").stdout)
    assert {one["tagname"]: one["per_100_g"] for one in shown["nutrients"]} == {"ENERC_KCAL": 52.0, "PROCNT": 0.26}
    assert shown["density"]["chosen"]["basis"] == "measured"
    assert "ECUSTFD" in tada("show", "sr28:09003").stdout
    found = json.loads(tada("search", "apple", "--json").stdout)
    assert found[0]["key"] == "apple"
    before = counts()
    again = tada("import", "sr28", tmp_path / "sr28.zip")
    assert (again.returncode, "was there already: nothing changed" in again.stdout) == (0, True)
    assert counts() == before
    assert "sr28" in tada("releases").stdout
    assert tada("use", "sr28").returncode == 0
    assert tada("show", "sr28:09003").returncode == 2


def test_unknown_format_and_missing_options_are_told(tada, tmp_path):
    assert "give one of sr28, fdc, fao-density, csv" in tada("import", "usda", tmp_path).stderr
    assert "--name, --version and --released-on" in tada("import", "csv", tmp_path).stderr
    assert "leave the options out" in tada("import", "sr28", tmp_path, "--name", "x").stderr
