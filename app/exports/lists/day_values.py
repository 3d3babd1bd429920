"""A day as its JSON has it: the columns of the table of days."""

from app.diary.queries import DayRow
from app.diary.study_days import judge_day
from app.nutrition.components import HEADLINE_COLUMNS


def day_values(day: DayRow) -> dict[str, object]:
    """A day's columns by name."""
    judged = judge_day(day)
    values: dict[str, object] = {
        "study": day.study_code,
        "participant": day.participant_code,
        "local_date": day.local_date,
        "study_day": day.study_day,
        "day_status": day.status,
        "ate_nothing": day.ate_nothing,
        "decided_by": day.decided_by,
        "meals": day.meals,
        "meals_after_closing": day.meals_after_closing,
        "median_upload_delay_seconds": day.median_upload_delay_seconds,
        "items": day.items,
        "unmeasured_meals": day.unmeasured_meals,
        "unmeasured_items": day.unmeasured_items,
        "provisional_items": day.provisional_items,
        "leftovers_unknown_items": day.leftovers_unknown_items,
        "consumed_g": day.consumed_g,
        "energy_to_basal_rate": judged.ratio,
        "plausibility": judged.verdict,
    }
    for name in HEADLINE_COLUMNS:
        amount = day.amount(name)
        values[name] = amount.value
        values[f"{name}_coverage"] = amount.coverage
    return values
