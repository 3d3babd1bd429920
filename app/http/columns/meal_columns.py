"""The columns of exported meals: a row a meal, with what its records that hold come to."""

from app.http.columns.column import Column
from app.http.columns.component_columns import headline_sums
from app.http.columns.record_columns import (
    CAPTURED_AT,
    CAPTURED_LOCAL,
    DAY_STATUS,
    LOCAL_DATE,
    MEAL_ID,
    PARTICIPANT,
    STUDY,
    STUDY_DAY,
    TIME_ZONE,
    UPLOAD_DELAY,
)

MEAL_STATUSES = (
    "receiving",
    "queued",
    "processing",
    "estimated",
    "needs_review",
    "failed",
    "confirmed",
)
MEAL_ORIGINS = ("photographed", "declared")
AFTER_STATUSES = (
    "receiving",
    "queued",
    "processing",
    "estimated",
    "needs_review",
    "failed",
    "nothing_left",
)
NO_SUM = "It is known of none of the meal's items, or there are none yet. Never 0."
NO_RUN = "No run has measured it."
NO_PHOTOGRAPH = "There is no such photograph."
UNKNOWN_PLACE = "Not told, or the study keeps no locations."
LONGITUDE = Column(
    "longitude",
    "number",
    "deg",
    "WGS84, as far as the study keeps locations.",
    empty=UNKNOWN_PLACE,
)
LATITUDE = Column(
    "latitude",
    "number",
    "deg",
    "WGS84, as far as the study keeps locations.",
    empty=UNKNOWN_PLACE,
)


def _hash(name: str, meaning: str) -> Column:
    return Column(name, "word", meaning=meaning, empty=NO_PHOTOGRAPH)


WHOSE = (STUDY, PARTICIPANT)
WHEN = (CAPTURED_AT, CAPTURED_LOCAL, TIME_ZONE, LOCAL_DATE)
ARRIVAL = (
    Column("received_at", "instant", meaning="When the first of it arrived at the server."),
    UPLOAD_DELAY,
)
DAY = (DAY_STATUS, STUDY_DAY)
STANDING = (
    Column("status", "word", meaning="Where the meal stands.", values=MEAL_STATUSES),
    Column(
        "origin",
        "word",
        meaning="Whether it was photographed, or told without photographs.",
        values=MEAL_ORIGINS,
    ),
    Column(
        "failure_code",
        "word",
        meaning="Why it could not be measured (docs/errors.md).",
        empty="It has not failed.",
    ),
    Column(
        "after_status",
        "word",
        meaning="Where its after-meal pair stands.",
        values=AFTER_STATUSES,
        empty="There is none.",
    ),
    Column(
        "provisional",
        "boolean",
        meaning="Whether an after-meal pair may still change what was eaten.",
    ),
)
FOODS = (
    Column(
        "food_keys",
        "words",
        meaning="Keys of the foods of its records that hold, in the items' order.",
    ),
    Column("flags", "words", meaning="Flags of its records that hold, each once."),
)
COUNTS = (
    Column("items", "integer", None, "Records that hold (not rejected)."),
    Column(
        "unmeasured_items",
        "integer",
        None,
        "Of these, those whose eaten grams are not known: not in the sums.",
    ),
    Column("unreviewed_items", "integer", None, "Of these, those that need a reviewer's look."),
    Column(
        "doubt",
        "number",
        "1",
        "The greatest doubt of its records, 0 to 1 (docs/review.md).",
        empty="It has no items.",
    ),
    Column("version", "integer", None, "Grows with every change of the meal."),
    Column(
        "consumed_g",
        "number",
        "g",
        "Edible grams eaten, summed over records that hold.",
        empty=NO_SUM,
    ),
)
SUMS = headline_sums(NO_SUM)
MEAL_RUN = (
    Column(
        "run_id",
        "id",
        meaning="The newest run of the pipeline on the meal's own pair.",
        empty=NO_RUN,
    ),
    Column("method", "word", meaning="The run's method of measuring volumes.", empty=NO_RUN),
    Column("pipeline_version", "word", meaning="The run's version of the pipeline.", empty=NO_RUN),
    Column(
        "marker",
        "word",
        meaning="The board that the run looked for.",
        empty=f"{NO_RUN} Or a stereo rig, poses or a depth map gave the scale.",
    ),
    Column(
        "food_tables",
        "word",
        meaning="The food tables in force at the run, `name version`, the first goes first; `; ` between them.",
        empty=NO_RUN,
    ),
)
PHOTOGRAPHS = (
    _hash("left_received_sha256", "SHA-256 of the left photograph as the phone sent it."),
    _hash(
        "left_stored_sha256",
        "SHA-256 of the left photograph as it is kept (perhaps without its location).",
    ),
    _hash("right_received_sha256", "SHA-256 of the right photograph as the phone sent it."),
    _hash("right_stored_sha256", "SHA-256 of the right photograph as it is kept."),
)

MEAL_COLUMNS = (MEAL_ID, *WHOSE, *WHEN, *ARRIVAL, *DAY, *STANDING, *FOODS, *COUNTS, *SUMS)
MEAL_PROVENANCE = (*MEAL_RUN, *PHOTOGRAPHS)
PLACE = (LONGITUDE, LATITUDE)
OF_LONG_MEAL = (MEAL_ID, *WHOSE, *WHEN, *DAY, *STANDING, *COUNTS)
