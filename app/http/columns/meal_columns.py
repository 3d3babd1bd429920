"""The columns of exported meals, of their photographs, and of participants, a row each."""

from app.http.columns.component_columns import headline_sums
from app.http.columns.dictionary import Column
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
from app.nutrition.intakes.energy_requirement import ACTIVITIES
from app.nutrition.intakes.life_stage import SEXES
from app.photos.slots import SLOTS

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
    "longitude", "number", "WGS84, as far as the study keeps locations.", "deg", empty=UNKNOWN_PLACE
)
LATITUDE = Column(
    "latitude", "number", "WGS84, as far as the study keeps locations.", "deg", empty=UNKNOWN_PLACE
)
PHOTOGRAPH_COLUMNS = (
    MEAL_ID,
    STUDY,
    PARTICIPANT,
    CAPTURED_AT,
    CAPTURED_LOCAL,
    LOCAL_DATE,
    Column(
        "slot",
        "word",
        "Which of the meal's photographs or depth maps it is, or its voice note.",
        values=SLOTS,
    ),
    Column("media_type", "word", "Of the bytes as they are kept."),
    Column("width_px", "integer", "Of the upright picture; 0: a voice note.", "px"),
    Column("height_px", "integer", "Of the upright picture; 0: a voice note.", "px"),
    Column("bytes", "integer", "Length as it is kept.", "B"),
    Column("received_sha256", "word", "SHA-256 of the bytes that the phone sent."),
    Column(
        "stored_sha256",
        "word",
        "SHA-256 of the bytes that are kept: others where the location was cut out.",
    ),
    Column("received_at", "instant", "When it arrived at the server."),
    Column("erased", "boolean", "Whether the picture was erased (retention, withdrawal)."),
    Column("erased_at", "instant", "When it was erased.", empty="It is there."),
    Column(
        "path",
        "word",
        "Path of the picture, re-encoded as JPEG (docs/limits.md), or of a map or voice note as kept.",
        empty="It was erased.",
    ),
)
UNKNOWN = "Nobody has entered it, or it was erased with the profile."
NO_MEALS = "There are no meals."

PROFILE = (
    Column("sex", "word", "The participant's sex.", values=SEXES, empty=UNKNOWN),
    Column(
        "age_years",
        "integer",
        "Age reached in the year of study day 1, or of the first phone's enrolment if there is no day 1 yet.",
        "a",
        empty="The year of birth is not known, or there is neither a day 1 nor a phone.",
    ),
    Column("height_cm", "number", "Height.", "cm", empty=UNKNOWN),
    Column(
        "weight_kg", "number", "Weight; in pregnancy, the weight before it.", "kg", empty=UNKNOWN
    ),
    Column("activity", "word", "Physical activity.", values=ACTIVITIES, empty=UNKNOWN),
    Column("is_pregnant", "boolean", "Whether the participant is pregnant.", empty=UNKNOWN),
    Column("trimester", "integer", "Trimester of the pregnancy, 1 to 3.", empty=UNKNOWN),
    Column("is_lactating", "boolean", "Whether the participant is lactating.", empty=UNKNOWN),
    Column("lactation_months", "integer", "Completed months since birth.", empty=UNKNOWN),
)
MEALS = (
    Column("meals", "integer", "Meals of the participant."),
    Column("first_meal_on", "day", "The first local day with a meal.", empty=NO_MEALS),
    Column("last_meal_on", "day", "The last local day with a meal.", empty=NO_MEALS),
)
PARTICIPANT_COLUMNS = (
    STUDY,
    PARTICIPANT,
    *PROFILE,
    Column(
        "starts_on",
        "day",
        "The local day that is study day 1.",
        empty="It is that of the first meal.",
    ),
    Column("arm", "word", "The study's arm that they are in.", empty="None was set."),
    Column("visit", "word", "The visit that they are at.", empty="None was set."),
    Column(
        "excluded", "word", "Why their data are left out of the analysis.", empty="They are not."
    ),
    Column(
        "enrolled_at",
        "instant",
        "When the first phone was enrolled.",
        empty="No phone was enrolled.",
    ),
    Column(
        "withdrawn_at", "instant", "When the participant left the study.", empty="They are in it."
    ),
    *MEALS,
)


def _hash(name: str, meaning: str) -> Column:
    return Column(name, "word", meaning, empty=NO_PHOTOGRAPH)


WHOSE = (STUDY, PARTICIPANT)
WHEN = (CAPTURED_AT, CAPTURED_LOCAL, TIME_ZONE, LOCAL_DATE)
ARRIVAL = (
    Column("received_at", "instant", "When the first of it arrived at the server."),
    UPLOAD_DELAY,
)
DAY = (DAY_STATUS, STUDY_DAY)
STANDING = (
    Column("status", "word", "Where the meal stands.", values=MEAL_STATUSES),
    Column(
        "origin",
        "word",
        "Whether it was photographed, or told without photographs.",
        values=MEAL_ORIGINS,
    ),
    Column(
        "failure_code",
        "word",
        "Why it could not be measured (docs/errors.md).",
        empty="It has not failed.",
    ),
    Column(
        "after_status",
        "word",
        "Where its after-meal pair stands.",
        values=AFTER_STATUSES,
        empty="There is none.",
    ),
    Column("provisional", "boolean", "Whether an after-meal pair may still change what was eaten."),
)
FOODS = (
    Column(
        "food_keys", "words", "Keys of the foods of its records that hold, in the items' order."
    ),
    Column("flags", "words", "Flags of its records that hold, each once."),
)
COUNTS = (
    Column("items", "integer", "Records that hold (not rejected)."),
    Column(
        "unmeasured_items",
        "integer",
        "Of these, those whose eaten grams are not known: not in the sums.",
    ),
    Column("unreviewed_items", "integer", "Of these, those that need a reviewer's look."),
    Column(
        "doubt",
        "number",
        "The greatest doubt of its records, 0 to 1 (docs/review.md).",
        "1",
        empty="It has no items.",
    ),
    Column("version", "integer", "Grows with every change of the meal."),
    Column(
        "consumed_g",
        "number",
        "Edible grams eaten, summed over records that hold.",
        "g",
        empty=NO_SUM,
    ),
)
SUMS = headline_sums(NO_SUM)
MEAL_RUN = (
    Column("run_id", "id", "The newest run of the pipeline on the meal's own pair.", empty=NO_RUN),
    Column("method", "word", "The run's method of measuring volumes.", empty=NO_RUN),
    Column("pipeline_version", "word", "The run's version of the pipeline.", empty=NO_RUN),
    Column(
        "marker",
        "word",
        "The board that the run looked for.",
        empty=f"{NO_RUN} Or a stereo rig, poses or a depth map gave the scale.",
    ),
    Column(
        "food_tables",
        "word",
        "The food tables in force at the run, `name version`, the first goes first; `; ` between them.",
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
