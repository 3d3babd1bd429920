"""The accuracy benchmark's own sums; the figures of whole sets are the data's scorer's."""

import json
from pathlib import Path

import pytest

from benchmarks import accuracy
from benchmarks.accuracy import BARS, POOLED, Bar, SceneSet, Scored, Setting, Table

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


def test_fruit_stand_beside_the_papers_whose_mean_error_is_computed_and_what_was_not_found_is_a_whole_error():
    table = accuracy.fruit_table([])
    assert table.rows[-1][:3] == ("mean error", "", "7.6 %")
    assert table.rows[2] == ("pear", "230", "195.1 (-15.2 %)")
    table = accuracy.fruit_table([scored(row(ml=177.6)), scored(row(ml=None)), scored(row(food="egg"))])
    assert table.header[-1] == "shape, calibrated"
    assert table.rows[0] == ("apple", "185", "181.5 (-1.9 %)", "-4.0 %, not found")
    assert accuracy.mean_error([-0.1, None, 0.1]) == "40.0 %"


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


def test_bars_hold_for_sets_of_their_kind_measured_in_their_way_only():
    figures = {bar.figure: 1.0 for bar in BARS} | {"items": 58}
    judged = [
        ("meals-fresh", "meals", CALIBRATED, figures),
        ("meals-fresh", "meals", Setting("paper", "calibrated", "none"), figures),
        ("other", "other", CALIBRATED, figures),
    ]
    table = accuracy.bar_table(judged)
    expected = [bar for bar in BARS if (bar.kind, bar.camera, bar.hints) == ("meals", "calibrated", "none")]
    assert len(table.rows) == len(expected)
    assert {cells[0] for cells in table.rows} == {"meals-fresh"}


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


def test_folders_of_one_name_are_told_apart_and_empty_ones_left_out(tmp_path):
    for folder in ("a/meals", "b/meals", "data/scenes/dev/paper6", "data/scenes/dev/hard"):
        (tmp_path / folder / "scene-1").mkdir(parents=True)
        (tmp_path / folder / "scene-2").mkdir()
    for path in tmp_path.glob("**/scene-*"):
        if "hard" not in path.parts:
            (path / "truth.json").touch()
    names = [str(tmp_path / "a" / "meals"), str(tmp_path / "b" / "meals"), "paper6", "hard"]
    found = accuracy.find_sets(tmp_path / "data", names, limit=1)
    assert [each.name for each in found] == [*names[:2], "paper6"]
    assert [each.kind for each in found] == ["meals", "meals", "paper6"]
    assert [len(each.scenes) for each in found] == [1, 1, 1]


def test_table_is_text_or_markdown_and_without_data_it_says_what_to_give(tmp_path, capsys):
    table = Table("Sets", ("scenes", "median"), (("paper6", "3.1 %"),))
    assert accuracy.as_text(table) == "Sets\nscenes  median\npaper6  3.1 %"
    assert accuracy.as_markdown(table) == "## Sets\n\n| scenes | median |\n|---|---|\n| paper6 | 3.1 % |"
    assert accuracy.main(["--data", str(tmp_path)]) == 2
    assert "TADA_SHARED_DATA" in capsys.readouterr().err


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
