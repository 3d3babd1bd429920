"""Measures of weighed foods against the scale: the table in, the figures and their intervals out."""

import csv
import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from app.cli.benchmark import WeighedFood, summary
from app.cli.main import cli

DEMO = Path(__file__).resolve().parents[3] / "app" / "demo_data" / "orange_kiwifruit"
COLUMNS = "meal,left,right,marker,food,x,y,grams,ml"
RUN = CliRunner()


def weighed(meal, measured, interval=(90.0, 110.0), food="rice"):
    return WeighedFood(meal, food, "g", 100.0, measured, *interval, "")


def test_figures_are_of_what_was_measured_and_intervals_by_meals():
    foods = [weighed("a", 110.0, (100.0, 121.0)), weighed("a", 90.0, (81.0, 99.0)), weighed("b", 120.0, (101.0, 140.0))]
    told = summary("rice", [*foods, weighed("c", None, (None, None))])
    assert (told.meals, told.foods, told.measured) == (2, 4, 3)
    assert told.error[0] == pytest.approx(40 / 3)
    assert told.bias == pytest.approx((20 / 3, 0.0, 20.0))
    assert told.inside == pytest.approx((100 / 3, 6.15, 79.23), abs=0.01)  # Wilson's interval of one in three
    assert summary("rice", [weighed("c", None, (None, None))]).error is None


def folder_of(tmp_path, *rows, columns=COLUMNS):
    for side in ("left", "right"):
        shutil.copy(DEMO / f"{side}.jpg", tmp_path)
    (tmp_path / "weighed.csv").write_text("\n".join([columns, *rows]) + "\n", encoding="utf-8")
    return str(tmp_path)


def test_meals_are_measured_and_sent_on_as_a_table(tmp_path):
    meal = "one,left.jpg,right.jpg,plain:9x7:11"
    folder = folder_of(
        tmp_path,
        f"{meal},orange,526,486,148,",
        f"{meal},kiwifruit,303,426,,121",
        "one,left.jpg,,coin:20.0,orange,1,1,9,",
    )
    output = tmp_path / "results.csv"
    run = RUN.invoke(cli, ["benchmark", folder, "-o", str(output), "--json"])
    assert run.exit_code == 0, run.output
    *_, of_all = json.loads(run.stdout)["summaries"]
    assert (of_all["name"], of_all["meals"], of_all["foods"]) == ("all", 1, 3)
    with output.open(encoding="utf-8", newline="") as file:
        of_other_photograph, orange, kiwifruit = csv.DictReader(file)
    assert (of_other_photograph["weighed"], orange["unit"], kiwifruit["unit"]) == ("9.0", "g", "ml")
    assert float(orange["low"]) < 148 < float(orange["high"])
    assert float(kiwifruit["measured"]) == pytest.approx(121, rel=0.05)


@pytest.mark.parametrize(
    ("rows", "columns", "says"),
    [
        (["one,left.jpg,right.jpg,,orange,1,1,,"], COLUMNS, "ml of orange, meal one, is no number: empty"),
        (["one,left.jpg,right.jpg,,orange,1,1,0,"], COLUMNS, "weighs nothing"),
        (["one,left.jpg,right.jpg,,orange,one,1,9,"], COLUMNS, "x of orange, meal one, is no number: one"),
        (["one,left.jpg,right.jpg,,orange,1,1,nan,"], COLUMNS, "grams of orange, meal one, is no number: nan"),
        (["one,left.jpg,,,orange,1,1,9,", "two,left.jpg,,,oranje,1,1,9,"], COLUMNS, "The food table has no oranje"),
        (["one,none.jpg,right.jpg,,orange,1,1,9,"], COLUMNS, "there is no photograph"),
        (["one,left.jpg"], "meal,photo", "Missing: left, food, x, y; unknown: photo"),
        ([], COLUMNS, "a row for each food"),
    ],
)
def test_table_that_cannot_be_is_refused_with_its_place(tmp_path, rows, columns, says):
    run = RUN.invoke(cli, ["benchmark", folder_of(tmp_path, *rows, columns=columns)])
    assert run.exit_code != 0
    assert says in " ".join((run.output + str(run.exception)).split())
