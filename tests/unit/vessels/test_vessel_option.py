"""The vessel library of `tada estimate --vessels`."""

import json
from pathlib import Path

import pytest

from app.core.errors import InvalidInputError
from app.estimates.estimate_files import read_options

MUG = {"name": "blue mug", "kind": "mug", "rim_diameter_mm": 80, "height_mm": 90, "capacity_ml": 350}


def test_list_of_vessels_in_a_file_reaches_the_options(tmp_path: Path) -> None:
    path = tmp_path / "vessels.json"
    path.write_text(json.dumps([MUG]))
    options = read_options(marker="plain:9x7:11", camera=None, method="shape", hints=(), vessels=path)
    assert [vessel.name for vessel in options.vessels] == ["blue mug"]


def test_file_that_is_no_list_of_vessels_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "vessels.json"
    path.write_text(json.dumps(MUG))
    with pytest.raises(InvalidInputError, match="must be a list"):
        read_options(marker="plain:9x7:11", camera=None, method="shape", hints=(), vessels=path)
