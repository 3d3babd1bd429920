"""The columns of exported days: a row a participant-day, as GET /v1/days has it."""

from app.http.columns.component_columns import headline_sums
from app.http.columns.dictionary import Column
from app.http.columns.record_columns import (
    DAY_STATUSES,
    LAYERS,
    LOCAL_DATE,
    PARTICIPANT,
    STUDY,
    STUDY_DAY,
)

VERDICTS = ("low", "plausible", "high", "unknown")
NO_SUM = "It is known of nothing that was eaten on the day. Never 0, but on a day when nothing was eaten."
UNMEASURED_MEALS = (
    "Meals of which no food is known (failed, not measured yet) and nobody said that there was "
    "none: not in the sums."
)
LEFTOVERS_UNKNOWN = (
    "Items that count as eaten up since nobody has looked what was left, where the study expects an after-meal pair: "
    "with any, what was consumed is an upper bound."
)


def _count(name: str, meaning: str) -> Column:
    return Column(name, "integer", meaning)


WHOSE = (STUDY, PARTICIPANT)
WHICH = (LOCAL_DATE,)
STANDING = (
    STUDY_DAY,
    Column(
        "day_status",
        "word",
        "closed: all that was eaten on the day is told. open: not so; leave it out of means.",
        values=DAY_STATUSES,
    ),
    Column(
        "ate_nothing",
        "boolean",
        "Closed by the word that nothing was eaten, and no meal says otherwise.",
    ),
    Column(
        "decided_by",
        "word",
        "Whose word about the day holds.",
        values=LAYERS[1:],
        empty="Nobody has said anything of the day.",
    ),
)
COUNTS = (
    _count("meals", "Meals of the day."),
    _count(
        "meals_after_closing", "Meals that came in after the day was closed: it may need a look."
    ),
    Column(
        "median_upload_delay_seconds",
        "number",
        "Median time from eating to the server, of the day's meals.",
        "s",
        empty="The day has no meals.",
    ),
    _count("items", "Records that hold (not rejected)."),
    _count("unmeasured_meals", UNMEASURED_MEALS),
    _count(
        "unmeasured_items", "Items whose eaten grams are not known: the sums are of the others."
    ),
    _count("provisional_items", "Items that an after-meal pair may still change."),
    _count("leftovers_unknown_items", LEFTOVERS_UNKNOWN),
    Column(
        "consumed_g",
        "number",
        "Edible grams eaten, summed over records that hold.",
        "g",
        empty=NO_SUM,
    ),
)
SUMS = headline_sums(NO_SUM)
PLAUSIBLE = (
    Column(
        "energy_to_basal_rate",
        "number",
        "The day's energy over the participant's basal metabolic rate.",
        "1",
        empty="The profile or the day's whole energy is not known.",
    ),
    Column(
        "plausibility",
        "word",
        "Of this day's energy alone, with the wide limits of one day (Goldberg, Black 2000).",
        values=VERDICTS,
    ),
)

DAY_COLUMNS = (*WHOSE, *WHICH, *STANDING, *COUNTS, *SUMS, *PLAUSIBLE)
OF_LONG_DAY = (*WHOSE, *WHICH, *STANDING)
