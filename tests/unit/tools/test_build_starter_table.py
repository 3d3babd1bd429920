"""The starter table's building from the public releases and the selection."""

import tomllib
from importlib import resources

import pytest

from app.foods.importers.fao_density import read_fao_rows
from app.foods.importers.sr28 import Sr28Release
from app.nutrition.foods import load_starter_table, parse_table
from tools.ecustfd import read_measured
from tools.starter_table.build import FOLDER, build, main
from tools.starter_table.densities import StarterSources

STARTER = resources.files("app.nutrition") / "starter"


@pytest.fixture(scope="module")
def sources(shared_data):
    tables = shared_data / "food_tables"
    return StarterSources(
        Sr28Release(tables / "sr28asc.zip"),
        read_fao_rows(tables / "fao_infoods_density_v2.xlsx"),
        read_measured((FOLDER / "ecustfd.csv").read_text()),
        selection(),
    )


def selection():
    return tomllib.loads((FOLDER / "selection.toml").read_text())


@pytest.mark.slow
def test_rebuilding_from_the_releases_gives_what_is_committed(sources):
    foods_json, nutrients_csv = build(sources, selection())
    assert foods_json == (STARTER / "foods.json").read_bytes()
    assert nutrients_csv == (STARTER / "nutrients.csv").read_bytes()


@pytest.mark.slow
def test_command_writes_a_table_that_loads(shared_data, tmp_path, capsys):
    tables = shared_data / "food_tables"
    main(
        [
            *("--sr28", str(tables / "sr28asc.zip")),
            *("--fao", str(tables / "fao_infoods_density_v2.xlsx")),
            *("-o", str(tmp_path)),
        ]
    )
    table = parse_table((tmp_path / "foods.json").read_bytes(), (tmp_path / "nutrients.csv").read_bytes())
    assert table.foods == load_starter_table().foods
    assert f"{len(table.foods)} foods" in capsys.readouterr().out


def only(key):
    chosen = selection()
    chosen["food"] = [food for food in chosen["food"] if food["key"] == key]
    return chosen


def test_selection_that_names_another_fao_row_is_refused(sources):
    changed = only("rice-white-cooked")
    changed["food"][0]["fao"][0]["row"] = 370
    with pytest.raises(ValueError, match="FAO row 370 is 'Rice, rough'"):
        build(sources, changed)


def test_food_without_a_density_for_its_form_is_refused(sources):
    changed = only("lasagna")
    del changed["food"][0]["fao"]
    with pytest.raises(ValueError, match="lasagna: no solid density"):
        build(sources, changed)


def test_selection_that_names_refuse_unknown_to_the_release_is_refused(sources):
    changed = only("banana")
    changed["food"][0]["served_without"] = ["crown"]
    with pytest.raises(ValueError, match="banana: SR28 names no part"):
        build(sources, changed)


def test_crumb_that_leaves_no_rest_is_refused(sources):
    changed = only("hamburger")
    changed["food"][0]["crumb"]["share"] = 1.0
    with pytest.raises(ValueError, match="leaves no rest"):
        build(sources, changed)


def test_measure_without_a_size_is_refused_as_a_piece(sources):
    changed = only("brownie")
    changed["food"][0]["pieces"] = [["18151", "1"]]
    with pytest.raises(ValueError, match="gives no size"):
        build(sources, changed)
