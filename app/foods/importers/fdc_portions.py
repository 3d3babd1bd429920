"""Convert a row of FoodData Central's food_portion.csv to a household measure.

The three data sets express "1 cup, chopped" in three ways. Foundation: amount 1, unit "cup", modifier "chopped". SR
Legacy: amount 1, no unit, modifier "cup, chopped". FNDDS: no amount, no unit, description "1 cup, chopped", and as
modifier a code.
"""

import re
from collections.abc import Mapping, Sequence

from app.foods.importers.imported import MAX_MEASURE, Skipped
from app.foods.importers.source_files import Place
from app.nutrition.portions import Portion

NO_UNIT = "undetermined"
# Weighed only by the laboratory: pairs of raw and cooked cuts, drippings.
LABORATORY_UNITS = frozenset(
    {"paired cooked w", "paired raw w", "dripping w", "orig ckd g", "orig rw g"}
)
NOT_EDIBLE = frozenset(
    {"peel", "unpeeled", "whole in shell", "in shell"}
)  # modifiers of weights that include or are waste

_LEADING = re.compile(
    r"^(?:(?P<whole>\d+(?:\.\d+)?)(?![\d/]))?\s*(?:(?P<part>\d+)/(?P<of>[1-9]\d*))?\s+(?=\S)"
)


def portion_of(
    place: Place,
    portion_id: str,
    fdc_id: str,
    fields: Sequence[str],
    units: Mapping[str, str],
    skipped: Skipped,
) -> Portion | None:
    """Convert one row. fields: amount, measure unit's id, description, modifier, grams. units: id -> name.

    Returns None for a row that is not a household measure, and counts it. Raises ImportFileError for an invalid figure.
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
