"""A row of FoodData Central's food_portion.csv -> a household measure.

The three data sets have three ways to say "1 cup, chopped". Foundation: amount 1, unit "cup", modifier "chopped". SR
Legacy: amount 1, no unit, modifier "cup, chopped". FNDDS: no amount, no unit, description "1 cup, chopped", and as
modifier a code.
"""

import re
from collections.abc import Mapping, Sequence

from app.foods.importers.imported import MAX_MEASURE, Skipped
from app.foods.importers.source_files import Place
from app.nutrition.portions import Portion

NO_UNIT = "undetermined"
# What the laboratory weighed: pairs of raw and cooked cuts, drippings.
LABORATORY_UNITS = frozenset({"paired cooked w", "paired raw w", "dripping w", "orig ckd g", "orig rw g"})
NOT_EDIBLE = frozenset({"peel", "unpeeled", "whole in shell", "in shell"})  # modifiers of weights with waste, or of it

_LEADING = re.compile(r"^(?:(?P<whole>\d+(?:\.\d+)?)(?![\d/]))?\s*(?:(?P<part>\d+)/(?P<of>[1-9]\d*))?\s+(?=\S)")


def portion_of(
    place: Place, portion_id: str, fdc_id: str, fields: Sequence[str], units: Mapping[str, str], skipped: Skipped
) -> Portion | None:
    """One row. fields: amount, measure unit's id, description, modifier, grams. units: measure_unit.csv, id -> name.

    None for what is no household measure, which is counted. Raises ImportFileError if a figure cannot be.
    """
    amount_text, unit_id, description, modifier, grams = fields
    unit = units.get(unit_id, NO_UNIT) if unit_id else NO_UNIT
    if unit_id and unit_id not in units:
        raise place.error(f"measure unit {unit_id} is none of measure_unit.csv")
    what = f"{fdc_id} {description or modifier or unit}"
    if unit in LABORATORY_UNITS:
        skipped.add("portions that only the laboratory weighed", what)
        return None
    if modifier.lower() in NOT_EDIBLE:
        skipped.add("portions that hold waste", what)
        return None
    if description == "Quantity not specified":
        skipped.add("portions of a quantity that is not specified", what)
        return None
    amount = place.number("amount", amount_text) if amount_text else None
    if amount is None:
        amount, description = _leading_amount(description)
    words = [] if unit == NO_UNIT else [unit]
    words += [text for text in (description, modifier) if text and not text.isdecimal()]
    mass_g = place.number("gram_weight", grams) if grams else 0.0
    if not amount or not mass_g or not words:
        skipped.add("portions without an amount, a measure or a weight", what)
        return None
    return Portion(portion_id, amount, " ".join(", ".join(words).split())[:MAX_MEASURE], mass_g)


def _leading_amount(description: str) -> tuple[float | None, str]:
    """The amount that a description opens with, and the rest: "1 1/2 cups" -> 1.5, "cups"; none -> None."""
    match = _LEADING.match(description)
    if match is None or not (match["whole"] or match["part"]):
        return None, description
    amount = float(match["whole"] or 0.0)
    if match["part"]:
        amount += int(match["part"]) / int(match["of"])
    return amount, description[match.end() :]
