"""The intervals of a record's amounts of components, which follow from that of its grams."""

from app.meals.record_models import EffectiveRecord
from app.nutrition.doubt import Estimate
from app.nutrition.nutrients import interval_in_proportion


def eaten_g(record: EffectiveRecord) -> Estimate | None:
    """The edible grams that were eaten, signed; None where they are not known."""
    value, low, high = record.consumed_g, record.consumed_low_g, record.consumed_high_g
    return Estimate(value, low, high) if value is not None and low is not None and high is not None else None


def nutrient_interval(record: EffectiveRecord, column: str) -> tuple[float, float] | None:
    """The 90 % interval of one of HEADLINE_COLUMNS; None where nothing is known of it."""
    amount, grams = getattr(record, column), eaten_g(record)
    return interval_in_proportion(amount, grams) if amount is not None and grams is not None else None
