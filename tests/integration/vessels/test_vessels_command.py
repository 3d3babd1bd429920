"""`tada vessels` as a person types it: a library in and out as a file, all of it or nothing."""

import json

import pytest

from app.db.session import Database
from app.people.studies import create_study
from tests.support.commands import run_tada

MUG = {"name": "Blue mug", "kind": "mug", "rim_diameter_mm": 82.0, "height_mm": 95.0, "capacity_ml": 400.0}
GLASS = {
    "name": "Glass",
    "kind": "glass",
    "rim_diameter_mm": 68.0,
    "height_mm": 110.0,
    "fill_line_mm": 85.0,
    "fill_line_ml": 200.0,
}
BOWL = {
    "name": "Bowl",
    "kind": "bowl",
    "rim_diameter_mm": 150.0,
    "height_mm": 60.0,
    "capacity_ml": None,
    "inside_profile_mm": [[0.0, 8.0], [40.0, 10.0], [75.0, 60.0]],
}


@pytest.fixture
def tada(prepared_database_url, tmp_path):
    database = Database(prepared_database_url)
    create_study(database, code="pilot", name="pilot")
    database.dispose()

    def run(*arguments):
        places = {"TADA_DATABASE_URL": prepared_database_url, "TADA_DATA_DIR": tmp_path / "data"}
        return run_tada("vessels", *arguments, **places)

    return run


@pytest.fixture
def library_file(tmp_path):
    def write(*vessels):
        path = tmp_path / "vessels.json"
        path.write_text(json.dumps(vessels))
        return path

    return write


def test_library_goes_in_and_comes_out_as_it_was_import_again_changes_what_differs_and_what_is_removed_is_retired(
    tada, library_file
):
    assert tada("import", "pilot", library_file(MUG, GLASS)).stdout == "2 added, 0 changed, 0 unchanged\n"
    again = tada("import", "pilot", library_file(MUG | {"capacity_ml": 410.0}, GLASS, BOWL))
    assert again.stdout == "1 added, 1 changed, 1 unchanged\n"
    exported = mug, bowl, glass = json.loads(tada("export", "pilot").stdout)
    assert mug == MUG | {"capacity_ml": 410.0, "inside_profile_mm": []}
    assert bowl == BOWL
    assert {name: glass[name] for name in GLASS} == GLASS
    assert 280.0 < glass["capacity_ml"] < 300.0  # 200 ml and 25 mm of 34 mm radius; the pipeline needs it
    assert tada("import", "pilot", library_file(*exported)).stdout == "0 added, 0 changed, 3 unchanged\n"
    assert tada("remove", "pilot", "blue MUG").stdout == "Blue mug is retired.\n"
    assert [vessel["name"] for vessel in json.loads(tada("export", "pilot").stdout)] == ["Bowl", "Glass"]
    listed = json.loads(tada("list", "pilot", "--json").stdout)
    assert {row["name"]: row["version"] for row in listed} == {"Blue mug": 3, "Bowl": 1, "Glass": 1}
    assert {row["author"][:12] for row in listed} == {"command line"}
    lines = tada("list", "pilot").stdout.splitlines()
    assert [line.endswith("retired") for line in lines] == [True, False, False]


def test_one_wrong_vessel_and_nothing_is_imported(tada, library_file):
    for wrong in (
        BOWL | {"height_mm": "tall"},
        MUG | {"name": "blue  MUG"},
        "a mug",
        GLASS | {"fill_line_ml": float("inf")},
    ):
        done = tada("import", "pilot", library_file(MUG, wrong))
        assert done.returncode == 2, wrong
        assert "vessel" in done.stderr.lower(), wrong
    assert json.loads(tada("export", "pilot").stdout) == []


def test_unknown_study_vessel_or_file_is_told(tada, library_file, tmp_path):
    assert "no such study" in tada("import", "second", library_file(MUG)).stderr
    assert "no such vessel" in tada("remove", "pilot", "Blue mug").stderr
    assert "cannot be read" in tada("import", "pilot", tmp_path / "none.json").stderr
    (tmp_path / "text.json").write_text("[{")
    assert "is not JSON" in tada("import", "pilot", tmp_path / "text.json").stderr
