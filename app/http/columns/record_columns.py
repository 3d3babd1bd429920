"""The columns of exported records (a row an item): those of the API's record, its food as key and name; provenance.

RECORD_COLUMNS are what a page of JSON has; PROVENANCE_COLUMNS, which files have behind them, tell
where it comes from.
"""

from app.http.columns.dictionary import Column
from app.nutrition.components import HEADLINES

RECORD_STATUSES = ("proposed", "needs_review", "confirmed", "corrected", "rejected")
ORIGINS = ("pipeline", "after", "declared", "added", "split", "merged")
LAYERS = ("automatic", "participant", "reviewer")
DAY_STATUSES = ("open", "closed")

NO_VOLUME = "There is no volume: nobody saw it, it could not be measured, or a person told grams."
NO_MASS = "Not known: no food, no density, or no volume."
NO_CONSUMED = "Not known how much was eaten; of a rejected item: nothing counts."
NO_CONTENT = "Not known: how much was eaten, or what the food table says of it. Never 0."
NO_FOOD = "Nobody has said what it is."

ITEM_ID = Column("id", "id", "The item's id: the same in every export.")
STUDY = Column("study", "word", "The study's code.")
PARTICIPANT = Column("participant", "word", "The participant's pseudonymous code in the study.")
MEAL_ID = Column(
    "meal_id", "id", "The meal's id, as its phone made it; unique for the participant."
)
CAPTURED_AT = Column("captured_at", "instant", "When it was eaten, in UTC.")
CAPTURED_LOCAL = Column(
    "captured_local",
    "local time",
    "When it was eaten, by the clock there: captured_at in time_zone.",
)
TIME_ZONE = Column("time_zone", "word", "The IANA time zone where it was eaten.")
LOCAL_DATE = Column(
    "local_date",
    "day",
    "The local day that it counts for; a study may let its days begin after midnight.",
)
UPLOAD_DELAY = Column(
    "upload_delay_seconds",
    "number",
    "From eating to the arrival of the meal's first part at the server.",
    "s",
)
DAY_STATUS = Column(
    "day_status",
    "word",
    "closed: all that was eaten on the day is told. open: not so; leave it out of means.",
    values=DAY_STATUSES,
)
STUDY_DAY = Column(
    "study_day",
    "integer",
    "The day's number for the participant, 1 on their first day.",
    empty="No first day is known.",
)
FOOD_KEY = Column(
    "food_key", "word", "The food's key: the same through releases and versions.", empty=NO_FOOD
)
CONSUMED_G = Column(
    "consumed_g",
    "number",
    "Edible grams eaten: (edible - left) x share. Signed: below 0 where more was left than served, within the error.",
    "g",
    empty=NO_CONSUMED,
)


def _number(name: str, unit: str, meaning: str, empty: str) -> Column:
    return Column(name, "number", meaning, unit, empty=empty)


AMOUNTS_OF_HEADLINES = tuple(
    _number(head.column, head.unit, f"{head.meaning} in what was eaten (consumed_g).", NO_CONTENT)
    for head in HEADLINES
)
WHEN = (CAPTURED_AT, CAPTURED_LOCAL, TIME_ZONE, LOCAL_DATE)
OF_MEAL = (MEAL_ID, STUDY, PARTICIPANT, *WHEN, UPLOAD_DELAY)
OF_FOOD = (
    FOOD_KEY,
    Column("food_name", "word", "Its name in the version that the record holds.", empty=NO_FOOD),
    Column(
        "food_table",
        "word",
        "The food table's name and release that the food is of.",
        empty=NO_FOOD,
    ),
)
STATE = (
    Column(
        "status",
        "word",
        "What people have made of it. rejected: it counts for nothing. needs_review: an amount is missing.",
        values=RECORD_STATUSES,
    ),
    Column(
        "origin",
        "word",
        "Where the item comes from: seen by the pipeline, declared, or made by a person.",
        values=ORIGINS,
    ),
    Column("provisional", "boolean", "Whether an after-meal pair may still change what was eaten."),
    Column(
        "reviewed", "boolean", "Whether a reviewer has had the last word, and the amount is known."
    ),
)
VOLUME = (
    _number("volume_ml", "ml", "Volume as served.", NO_VOLUME),
    _number("volume_low_ml", "ml", "Lower end of the volume's 90 % interval.", NO_VOLUME),
    _number("volume_high_ml", "ml", "Upper end of the volume's 90 % interval.", NO_VOLUME),
    _number(
        "density_g_per_ml",
        "g/ml",
        "The density that turned the volume into grams.",
        "None was used: a person told the grams, or none is known.",
    ),
)
AMOUNTS = (
    _number("mass_g", "g", "Grams as served, with peel, core and bone.", NO_MASS),
    _number(
        "mass_low_g",
        "g",
        "Lower end of the mass's 90 % interval: volume and density together.",
        NO_MASS,
    ),
    _number("mass_high_g", "g", "Upper end of the mass's 90 % interval.", NO_MASS),
    _number("edible_g", "g", "Grams as served, without peel, core and bone.", NO_MASS),
    Column(
        "share",
        "number",
        "The participant's share of a dish that several persons eat from; 1: all.",
        "1",
    ),
    _number(
        "left_g",
        "g",
        "Edible grams that were left over.",
        "Nobody has looked: it counts as eaten up.",
    ),
    CONSUMED_G,
    _number("consumed_low_g", "g", "Lower end of the 90 % interval of consumed_g.", NO_CONSUMED),
    _number("consumed_high_g", "g", "Upper end of the 90 % interval of consumed_g.", NO_CONSUMED),
    *AMOUNTS_OF_HEADLINES,
)

FOOD_VERSION = (
    Column(
        "food_version",
        "integer",
        "The food's version in its table's release: above 1, it was corrected.",
        empty=NO_FOOD,
    ),
)
NO_RUN = "No run measured it: it was told by a person, or waits to be measured."
OF_RUN = (
    Column(
        "run_id", "id", "The run of the pipeline that measured the item as it stands.", empty=NO_RUN
    ),
    Column("method", "word", "The run's method of measuring volumes.", empty=NO_RUN),
    Column("pipeline_version", "word", "The run's version of the pipeline.", empty=NO_RUN),
)
OF_WEIGHING = (
    Column(
        "food_said_by",
        "word",
        "Who said what it is: the server by itself or by the phone's hint (automatic), or a person.",
        values=LAYERS,
        empty=NO_FOOD,
    ),
    Column(
        "density_basis", "word", "What kind of figure the density is.", empty="No density was used."
    ),
    Column(
        "density_sd_g_per_ml",
        "number",
        "The density's spread (one sd).",
        "g/ml",
        empty="No density was used.",
    ),
    Column("edible_share", "number", "Edible grams a gram as served.", "1", empty=NO_FOOD),
)
DOUBT = (
    Column(
        "doubt",
        "number",
        "The review queue's order, 0 to 1 (docs/review.md): how much a look at it would tell. 0: it was rejected.",
        "1",
    ),
)

RECORD_COLUMNS = (
    ITEM_ID,
    *OF_MEAL,
    *STATE,
    *OF_FOOD,
    *VOLUME,
    Column("density_source", "word", "Who measured the density.", empty="No density was used."),
    *AMOUNTS,
    Column(
        "flags",
        "words",
        "Causes of doubt that are known by name (docs/flags.md, docs/after-meal.md).",
    ),
    Column(
        "change_seq",
        "integer",
        "Grows with each change of the study: what is new has a larger one.",
    ),
    DAY_STATUS,
    STUDY_DAY,
)
PROVENANCE_COLUMNS = (*FOOD_VERSION, *OF_RUN, *OF_WEIGHING, *DOUBT)
OF_LONG_RECORD = (ITEM_ID, *OF_MEAL, *STATE, *OF_FOOD, CONSUMED_G)
