"""A day as its JSON has it: the columns of the table of days."""

from app.diary.queries import DayRow
from app.diary.study_days import judge_day
from app.http.columns.day_columns import COUNTS
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
        **{column.name: getattr(day, column.name) for column in COUNTS},
        "energy_to_basal_rate": judged.ratio,
        "plausibility": judged.verdict,
    }
    for name in HEADLINE_COLUMNS:
        amount = day.amount(name)
        values[name] = amount.value
        values[f"{name}_coverage"] = amount.coverage
    return values
