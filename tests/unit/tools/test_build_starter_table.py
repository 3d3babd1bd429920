"""The starter table's building from the public releases and the selection."""

import tomllib
from importlib import resources

import pytest

from app.foods.importers.fao_density import read_fao_rows
from app.foods.importers.sr28 import Sr28Release
from app.nutrition.foods import load_starter_table
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
def test_command_rebuilds_from_the_releases_what_is_committed(shared_data, tmp_path, capsys):
    tables = shared_data / "food_tables"
    main(
        [
            *("--sr28", str(tables / "sr28asc.zip")),
            *("--fao", str(tables / "fao_infoods_density_v2.xlsx")),
            *("-o", str(tmp_path)),
        ]
    )
    for name in ("foods.json", "nutrients.csv"):
        assert (tmp_path / name).read_bytes() == (STARTER / name).read_bytes()
    assert f"{len(load_starter_table().foods)} foods" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "change", "words"),
    [
        ("rice-white-cooked", lambda food: food["fao"][0].update(row=370), "FAO row 370 is 'Rice, rough'"),
        ("lasagna", lambda food: food.pop("fao"), "lasagna: no solid density"),
        ("banana", lambda food: food.update(served_without=["crown"]), "banana: SR28 names no part"),
        ("hamburger", lambda food: food["crumb"].update(share=1.0), "leaves no rest"),
        ("brownie", lambda food: food.update(pieces=[["18151", "1"]]), "gives no size"),
    ],
)
def test_selection_that_does_not_fit_the_releases_is_refused(sources, key, change, words):
    chosen = selection()
    chosen["food"] = [food for food in chosen["food"] if food["key"] == key]
    change(chosen["food"][0])
    with pytest.raises(ValueError, match=words):
        build(sources, chosen)
