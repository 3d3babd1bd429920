"""Which folders of photographs show which food of the starter table: tools/shipped_index/labels.csv."""

import csv
import re
from collections import Counter
from pathlib import Path

from app.nutrition.foods import load_starter_table

LABELS = Path(__file__).parents[3] / "tools" / "shipped_index" / "labels.csv"
NOT_IN_THE_STARTER_TABLE = {"mooncake", "sachima"}  # no public table at hand has figures for them
CHINESE = re.compile("[\u4e00-\u9fff]")
LEAST_FOODS = 120


def labels():
    with LABELS.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def mapped_foods():
    keys = {row["food_key"] for row in labels()}
    return [food for food in load_starter_table().foods if food.key in keys]


def test_each_folder_stands_once_and_shows_a_food_of_the_starter_table():
    rows = labels()
    assert rows[0].keys() == {"source", "folder", "food_key"}
    assert {row["source"] for row in rows} == {"ecustfd", "grocery", "dishes"}
    folders = Counter((row["source"], row["folder"]) for row in rows)
    assert [folder for folder, count in folders.items() if count > 1] == []
    known = {food.key for food in load_starter_table().foods}
    assert {row["food_key"] for row in rows} - known == NOT_IN_THE_STARTER_TABLE


def test_foods_are_many_and_each_has_names_in_four_languages_a_density_and_a_portion():
    foods = mapped_foods()
    assert len(foods) >= LEAST_FOODS
    for food in foods:
        names = [food.name, *food.aliases]
        chinese = [name for name in names if CHINESE.search(name)]
        assert chinese, food.key
        assert len(names) - len(chinese) >= 3, food.key  # English, German, Spanish
        assert food.densities, food.key
        assert food.portions, food.key
