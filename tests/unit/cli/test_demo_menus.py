"""What the sample study eats is in the starter table, and its photographs are bundled."""

import csv
import importlib.resources
import io

from app.cli import demo
from app.cli.demo import OCCASIONS
from app.cli.demo_study import PHOTOGRAPHED

BUNDLED = importlib.resources.files("app") / "demo_data"
STARTER = importlib.resources.files("app") / "nutrition" / "starter" / "nutrients.csv"
PLATES = {plate.folder: plate for plate in vars(demo).values() if isinstance(plate, demo.Plate)}


def test_every_food_of_the_sample_study_is_in_the_starter_table_and_every_bundled_pair_in_the_study():
    known = {row["key"] for row in csv.DictReader(io.StringIO(STARTER.read_text()))}
    told = {food for _, dishes in OCCASIONS for dish in dishes for food, _ in dish}
    seen = {food for plate in PLATES.values() for _, food in plate.points + plate.left_over}
    assert told | seen <= known
    folders = {entry.name for entry in BUNDLED.iterdir() if entry.is_dir()}
    assert folders | {""} == {meal.plate.folder for meal in PHOTOGRAPHED} == set(PLATES)
