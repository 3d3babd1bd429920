"""What the sample study eats is in the starter table, and its photographs are bundled."""

import csv
import importlib.resources
import io

from app.cli.demo import PLATES, SAMPLE
from app.cli.demo_study import PHOTOGRAPHED

BUNDLED = importlib.resources.files("app") / "demo_data"
STARTER = importlib.resources.files("app") / "nutrition" / "starter" / "nutrients.csv"


def test_every_food_of_the_sample_study_is_in_the_starter_table_and_every_bundled_pair_in_the_study():
    known = {row["key"] for row in csv.DictReader(io.StringIO(STARTER.read_text()))}
    told = {food for meal in SAMPLE["occasions"] for dish in meal["dishes"] for food in dish}
    seen = {food for plate in PLATES.values() for food in (*plate.points, *plate.left_over)}
    assert told | seen <= known
    folders = {entry.name for entry in BUNDLED.iterdir() if entry.is_dir()}
    assert folders | {""} == {meal.plate.folder for meal in PHOTOGRAPHED} == {plate.folder for plate in PLATES.values()}
