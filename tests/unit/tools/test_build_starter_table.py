"""The starter table's building from the public releases and the selection."""

from importlib import resources

import pytest

from app.nutrition.foods import load_starter_table
from tools.starter_table.build import main

STARTER = resources.files("app.nutrition") / "starter"


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
