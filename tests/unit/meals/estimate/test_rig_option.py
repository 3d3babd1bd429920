"""`tada estimate` with --rig, --poses or --vessels: read from their files, alone or not at all."""

import json
from pathlib import Path

import pytest

from app.core.errors import InvalidInputError
from app.meals.estimate.estimate_files import estimate_files, read_options
from app.meals.estimate.estimate_json import options_from_json, options_to_json
from tests.unit.vision.poses import arkit_poses
from tests.unit.vision.stereo_scene import blank_views
from tests.unit.vision.test_rig import FILE


@pytest.fixture
def rig_file(tmp_path):
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(FILE))
    return path


def test_options_with_a_rig_have_no_marker_survive_json_and_a_rig_beside_one_is_refused(rig_file):
    options = read_options(marker=None, camera=None, rig=rig_file, method="shape", hints=())
    assert options.marker is None
    assert options.rig.baseline_mm == 60.0
    assert options_from_json(json.loads(json.dumps(options_to_json(options)))) == options
    options = read_options(marker=None, camera=None, method="shape", hints=())
    assert str(options.marker) == "plain:9x7:11"
    assert options.rig is None
    for given in ({"marker": "plain:9x7:11", "camera": None}, {"marker": None, "camera": rig_file}):
        with pytest.raises(InvalidInputError, match="leave --marker and --camera out"):
            read_options(**given, rig=rig_file, method="shape", hints=())


@pytest.mark.parametrize(
    ("content", "reason"), [(b"{", "is not JSON"), (b"\xff", "UTF-8"), (b"[]", "JSON object"), (None, "cannot be read")]
)
def test_file_that_is_no_rig_is_refused_with_its_name(tmp_path, content, reason):
    path = tmp_path / "broken.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InvalidInputError, match=reason) as refused:
        read_options(marker=None, camera=None, rig=path, method="shape", hints=())
    assert "broken.json" in refused.value.message


def test_empty_marker_and_options_without_any_scale_are_refused():
    with pytest.raises(InvalidInputError, match="no marker"):
        read_options(marker="", camera=None, method="shape", hints=())
    with pytest.raises(InvalidInputError) as refused:
        options_from_json({"marker": None, "hints": []})
    assert refused.value.code == "marker_missing"


@pytest.mark.parametrize("method", ["paper", "shape"])
def test_photographs_that_would_not_be_used_are_refused(rig_file, method, tmp_path):
    rig = rig_file if method == "shape" else None
    options = read_options(marker=None, camera=None, rig=rig, method=method, hints=())
    with pytest.raises(InvalidInputError, match="leave the others out"):
        estimate_files(
            [tmp_path / "1", tmp_path / "2", tmp_path / "3"], options, max_pixels=1, debug=None, on_stage=None
        )


def test_poses_of_a_file_take_the_markers_place_and_survive_json(tmp_path, rig_file):
    poses, camera = tmp_path / "poses.json", tmp_path / "camera.json"
    poses.write_text(json.dumps(arkit_poses(*blank_views())))
    camera.write_text(json.dumps(FILE["left"] | {"width": 1024, "height": 768}))
    options = read_options(marker=None, camera=camera, poses=poses, method="shape", hints=())
    assert options.marker is None
    assert options_from_json(json.loads(json.dumps(options_to_json(options)))) == options
    with_marker = read_options(marker="plain:9x7:11", camera=camera, poses=poses, method="shape", hints=())
    assert (str(with_marker.marker), with_marker.poses) == ("plain:9x7:11", options.poses)
    for given in ({"camera": None}, {"camera": None, "rig": rig_file}):
        with pytest.raises(InvalidInputError, match="--poses needs --camera"):
            read_options(marker=None, poses=poses, method="shape", hints=(), **given)
    for count in (1, 3):
        with pytest.raises(InvalidInputError, match="two photographs"):
            estimate_files([tmp_path / "left.jpg"] * count, options, max_pixels=1, debug=None, on_stage=None)


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
