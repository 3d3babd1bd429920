"""Which real pairs there are, and their sums; no photograph is needed for either."""

import json

import numpy as np
import pytest

from benchmarks import real_pairs as real

LENS = {"fx": 715.0, "fy": 715.0, "cx": 639.5, "cy": 359.5, "distortion": [0.0] * 5}
SHEET = {"dictionary": "DICT_6X6_250", "cols": 5, "rows": 7, "marker_mm": 35.0, "separation_mm": 5.0}


def case(name, left, right, **other):
    photographs = {"left": f"{left}.jpg", "left_card": f"{left}_card.jpg"}
    photographs |= {"right": f"{right}.jpg", "right_card": f"{right}_card.jpg"}
    hint = {"point": [600, 300]}
    return {"name": name, "truth_ml": 98.0, "card": "plain:9x7:9", "hint": hint} | photographs | other


def folder_of(tmp_path, *cases):
    (tmp_path / "cases.json").write_text(json.dumps(cases))
    (tmp_path / "camera.json").write_text(json.dumps({"width": 1280, "height": 720} | LENS))
    (tmp_path / "rig.json").write_text(json.dumps({"width": 1280, "height": 720, "left": LENS, "right": LENS}))
    return tmp_path


def test_photographs_of_a_sheet_are_combined_once_where_the_angle_suits(tmp_path, monkeypatch):
    angles = {"a.jpg": 0.0, "b.jpg": 10.0, "c.jpg": 20.0, "d.jpg": 55.0}

    def centre_mm(_, photograph, __):
        angle = np.radians(angles[photograph])
        return np.array([400 * np.sin(angle), 0.0, -400 * np.cos(angle)])

    monkeypatch.setattr(real, "_centre_mm", centre_mm)
    on_sheet = {"camera": "camera.json", "aruco": SHEET}
    pairs = real.real_pairs(folder_of(tmp_path, case("ab", "a", "b", **on_sheet), case("cd", "c", "d", **on_sheet)))
    # The two cases, and of the other four combinations those of 10 and 20 degrees whose left view has a hint.
    assert [pair.name for pair in pairs if not pair.name.endswith("sheet")] == ["ab", "cd", "a c", "c b"]


def test_refused_pairs_are_counted_and_do_not_enter_the_error_and_nothing_measured_has_none():
    measured = {"error": 0.1, "inside": True}
    summary = real.summarise([measured, {"error": -0.02, "inside": False}, {"error": None, "inside": False}])
    assert (summary["pairs"], summary["measured"]) == (3, 2)
    assert summary["mean_error"] == pytest.approx(6.0)
    assert summary["bias"] == pytest.approx(4.0)
    assert summary["coverage"] == pytest.approx(50.0)
    assert real.summarise([{"error": None, "inside": False}]) == {"pairs": 1, "measured": 0}
