"""Rows of FoodData Central's food_portion.csv as household measures; WWEIA's food categories.

The three data sets express "1 cup, chopped" in three ways. Foundation: amount 1, unit "cup",
modifier "chopped". SR Legacy: amount 1, no unit, modifier "cup, chopped". FNDDS: no amount, no
unit, description "1 cup, chopped", and as modifier a code.

What We Eat in America's categories tell which foods are mixed dishes, and the group by which the
form is inferred. Their four digits are ordered: 1000s milk and dairy, 2000s protein foods, 3000s
mixed dishes, 4000s grains, 5000s snacks and sweets, 6000s fruits and vegetables, 7000s beverages,
8000s fats, condiments and sugars, 9000s infant foods.
"""

import re
from bisect import bisect_right
from collections.abc import Mapping, Sequence

from app.foods.importers.source_files import MAX_MEASURE, Place, Skipped
from app.nutrition.portions import Portion

NO_UNIT = "undetermined"
# Weighed only by the laboratory: pairs of raw and cooked cuts, drippings.
LABORATORY_UNITS = frozenset(
    {"paired cooked w", "paired raw w", "dripping w", "orig ckd g", "orig rw g"}
)
# modifiers of weights that include or are waste
NOT_EDIBLE = frozenset({"peel", "unpeeled", "whole in shell", "in shell"})

_LEADING = re.compile(
    r"^(?:(?P<whole>\d+(?:\.\d+)?)(?![\d/]))?\s*(?:(?P<part>\d+)/(?P<of>[1-9]\d*))?\s+(?=\S)"
)
# First code -> the group, by its name in usual_form.py.
_GROUPS: tuple[tuple[int, str], ...] = (
    (0, "Meals, Entrees, and Side Dishes"),
    (1000, "Beverages"),
    (1600, "Dairy and Egg Products"),
    (2000, "Meat"),
    (2500, "Dairy and Egg Products"),
    (2600, "Sausages and Luncheon Meats"),
    (2800, "Legumes and Legume Products"),
    (2804, "Nut and Seed Products"),
    (2806, "Legumes and Legume Products"),
    (3000, "Meals, Entrees, and Side Dishes"),
    (3800, "Soups, Sauces, and Gravies"),
    (4000, "Cereal Grains and Pasta"),
    (4200, "Baked Products"),
    (4600, "Breakfast Cereals"),
    (5000, "Snacks"),
    (5200, "Baked Products"),
    (5700, "Sweets"),
    (6000, "Fruits and Fruit Juices"),
    (6400, "Vegetables and Vegetable Products"),
    (7000, "Beverages"),
    (8000, "Fats and Oils"),
    (8400, "Soups, Sauces, and Gravies"),
    (8408, "Vegetables and Vegetable Products"),
    (8410, "Soups, Sauces, and Gravies"),
    (8800, "Sweets"),
    (9000, "Baby Foods"),
    (9200, "Beverages"),
    (9800, "Snacks"),
    (9999, "Meals, Entrees, and Side Dishes"),
)
_STARTS = [start for start, _ in _GROUPS]


def portion_of(
    place: Place,
    portion_id: str,
    fdc_id: str,
    fields: Sequence[str],
    units: Mapping[str, str],
    skipped: Skipped,
) -> Portion | None:
    """Convert one row.

    fields: amount, measure unit's id, description, modifier, grams. units: id -> name.

    Returns None for a row that is not a household measure, and counts it. Raises ImportFileError
    for an invalid figure.
    """
    amount_text, unit_id, description, modifier, grams = fields
    unit = units.get(unit_id, NO_UNIT) if unit_id else NO_UNIT
    if unit_id and unit_id not in units:
        raise place.error(f"measure unit {unit_id} is none of measure_unit.csv")
    example = f"{fdc_id} {description or modifier or unit}"
    if unit in LABORATORY_UNITS:
        skipped.add("portions that only the laboratory weighed", example)
        return None
    if modifier.lower() in NOT_EDIBLE:
        skipped.add("portions that hold waste", example)
        return None
    if description == "Quantity not specified":
        skipped.add("portions of a quantity that is not specified", example)
        return None
    amount = place.number("amount", amount_text) if amount_text else None
    if amount is None:
        amount, description = _leading_amount(description)
    texts = [] if unit == NO_UNIT else [unit]
    texts += [text for text in (description, modifier) if text and not text.isdecimal()]
    mass_g = place.number("gram_weight", grams) if grams else 0.0
    if not amount or not mass_g or not texts:
        skipped.add("portions without an amount, a measure or a weight", example)
        return None
    return Portion(portion_id, amount, " ".join(", ".join(texts).split())[:MAX_MEASURE], mass_g)


def _leading_amount(description: str) -> tuple[float | None, str]:
    """Split the leading amount from a description: "1 1/2 cups" -> 1.5, "cups"; None without an amount."""
    match = _LEADING.match(description)
    if match is None or not (match["whole"] or match["part"]):
        return None, description
    amount = float(match["whole"] or 0.0)
    if match["part"]:
        amount += int(match["part"]) / int(match["of"])
    return amount, description[match.end() :]


def group_of_category(code: int) -> str:
    """Return the SR group by which the form of a food of this category is inferred."""
    return _GROUPS[bisect_right(_STARTS, code) - 1][1]


def is_mixed_category(code: int) -> bool:
    """Return whether the category's foods are dishes of several foods (including sandwiches, pizza and soups)."""
    return 3000 <= code <= 3999
