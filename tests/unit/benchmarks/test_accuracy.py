"""The accuracy benchmark's own sums; the figures of whole sets are the data's scorer's."""

import json
from pathlib import Path

import pytest

from benchmarks import accuracy
from benchmarks.accuracy import POOLED, Target


def summary(**figures):
    return {"items": 58, "interval_coverage_percent": 90.0, "interval_skill": None} | figures


@pytest.mark.parametrize(
    ("target", "figures", "expected"),
    [
        (Target("meals", "exif", "mape_percent", most=9.0), {"mape_percent": 9.0}, "met"),
        (Target("meals", "exif", "mape_percent", most=9.0), {"mape_percent": 9.01}, "MISSED"),
        (Target(POOLED, "exif", "bias_percent", least=-3.0, most=3.0), {"bias_percent": -3.2}, "MISSED"),
        (Target(POOLED, "exif", "interval_skill", least=0.05), {}, "open: 58 foods only"),
        (Target(POOLED, "exif", "interval_coverage_percent", most=97.0, least_items=60), {}, "open: 58 foods only"),
        (Target(POOLED, "exif", "interval_coverage_percent", most=97.0, least_items=60), {"items": 60}, "met"),
    ],
)
def test_target_is_met_missed_or_open(target, figures, expected):
    assert accuracy.verdict(target, summary(**figures)) == expected


@pytest.mark.slow
def test_one_scene_is_scored_as_the_scorer_does(shared_data, tmp_path, capsys):
    output = tmp_path / "rows.json"
    told = ["--scenes", "paper6", "--limit", "1", "--method", "shape", "--camera", "calibrated", "--json", str(output)]
    assert accuracy.main([*told, "--data", str(shared_data), "--markdown"]) == 0
    rows = json.loads(Path(output).read_text())
    assert [(each["set"], each["scene"], each["method"]) for each in rows] == [("paper6", "apple-1", "shape")]
    printed = capsys.readouterr().out
    assert "| paper6 | shape | calibrated | 1 of 1 | 0 |" in printed
    assert f"{100 * rows[0]['error']:+.1f} %" in printed
