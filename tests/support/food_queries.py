"""What people type into a food search, and what each of them expects to find: tests/data/food_search/judged.csv."""

import csv
from pathlib import Path

JUDGED = Path(__file__).parents[1] / "data" / "food_search" / "judged.csv"


def judged():
    return list(csv.DictReader(JUDGED.read_text(encoding="utf-8").splitlines()))
