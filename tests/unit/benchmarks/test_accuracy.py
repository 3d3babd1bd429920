"""The accuracy benchmark's own sums; the figures of whole sets are the data's scorer's."""

import json
from pathlib import Path

import pytest

from benchmarks import accuracy
from benchmarks.accuracy import BARS, POOLED, Bar, SceneSet, Scored, Setting

CALIBRATED = Setting("shape", "calibrated", "none")
PAPER6 = SceneSet("paper6", "paper6", ())


def row(food="apple", true_ml=185.0, ml=190.0, **other):
    error = None if ml is None else ml / true_ml - 1
    interval = None if ml is None else [0.9 * ml, 1.1 * ml]
    is_inside = bool(interval and interval[0] <= true_ml <= interval[1])
    return {
        "scene": "one",
        "food": food,
        "true_ml": true_ml,
        "ml": ml,
        "interval": interval,
        "iou": 0.9,
        "error": error,
        "inside": is_inside,
        "width": 0.1,
        "failure": None,
        "seconds": 1.0,
        "wall_seconds": 2.0,
    } | other


def scored(*rows, setting=CALIBRATED, scene_set=PAPER6, spurious=0):
    scene = {"scene": "one", "spurious": spurious, "count_correct": spurious == 0}
    return Scored(scene_set, setting, list(rows), scene)


def summary(**figures):
    return {"items": 58, "interval_coverage_percent": 90.0, "interval_skill": None} | figures


@pytest.mark.parametrize(
    ("bar", "figures", "expected"),
    [
        (Bar("meals", "exif", "mape_percent", most=9.0), {"mape_percent": 9.0}, "met"),
        (Bar("meals", "exif", "mape_percent", most=9.0), {"mape_percent": 9.01}, "MISSED"),
        (Bar(POOLED, "exif", "bias_percent", least=-3.0, most=3.0), {"bias_percent": -3.2}, "MISSED"),
        (Bar(POOLED, "exif", "interval_skill", least=0.05), {}, "open: 58 foods only"),
        (Bar(POOLED, "exif", "interval_coverage_percent", most=97.0, least_items=60), {}, "open: 58 foods only"),
        (Bar(POOLED, "exif", "interval_coverage_percent", most=97.0, least_items=60), {"items": 60}, "met"),
    ],
)
def test_bar_is_met_missed_or_open(bar, figures, expected):
    assert accuracy.verdict(bar, summary(**figures)) == expected


def test_summary_is_the_scorers_over_all_scenes_that_are_pooled_and_every_bar_names_a_figure_of_it(shared_data):
    scorer = accuracy.load_scorer(shared_data / "accuracy" / "score.py")
    figures = accuracy.summarise(scorer, [scored(row())])
    assert {bar.figure for bar in BARS} <= figures.keys()
    own = scorer.run_scene
    figures = accuracy.summarise(
        scorer, [scored(row(true_ml=100.0, ml=110.0)), scored(row(true_ml=100.0, ml=None), spurious=1)]
    )
    assert figures["mape_percent"] == 55.0
    assert (figures["found_percent"], figures["right_count_percent"], figures["spurious"]) == (50.0, 50.0, 1)
    assert scorer.run_scene is own


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
