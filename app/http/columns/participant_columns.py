"""The columns of exported participants: a row a person, with the profile and how many meals there are."""

from app.http.columns.column import Column
from app.http.columns.record_columns import PARTICIPANT, STUDY
from app.nutrition.intakes.energy_requirement import ACTIVITIES
from app.nutrition.intakes.life_stage import SEXES

UNKNOWN = "Nobody has entered it, or it was erased with the profile."
NO_MEALS = "There are no meals."

PROFILE = (
    Column("sex", "word", meaning="The participant's sex.", values=SEXES, empty=UNKNOWN),
    Column(
        "age_years",
        "integer",
        "a",
        "Age reached in the year of study day 1, or of the first phone's enrolment if there is no day 1 yet.",
        empty="The year of birth is not known, or there is neither a day 1 nor a phone.",
    ),
    Column("height_cm", "number", "cm", "Height.", empty=UNKNOWN),
    Column(
        "weight_kg", "number", "kg", "Weight; in pregnancy, the weight before it.", empty=UNKNOWN
    ),
    Column("activity", "word", meaning="Physical activity.", values=ACTIVITIES, empty=UNKNOWN),
    Column("is_pregnant", "boolean", meaning="Whether the participant is pregnant.", empty=UNKNOWN),
    Column("trimester", "integer", meaning="Trimester of the pregnancy, 1 to 3.", empty=UNKNOWN),
    Column(
        "is_lactating", "boolean", meaning="Whether the participant is lactating.", empty=UNKNOWN
    ),
    Column("lactation_months", "integer", meaning="Completed months since birth.", empty=UNKNOWN),
)
MEALS = (
    Column("meals", "integer", meaning="Meals of the participant."),
    Column("first_meal_on", "day", meaning="The first local day with a meal.", empty=NO_MEALS),
    Column("last_meal_on", "day", meaning="The last local day with a meal.", empty=NO_MEALS),
)
PARTICIPANT_COLUMNS = (
    STUDY,
    PARTICIPANT,
    *PROFILE,
    Column(
        "starts_on",
        "day",
        meaning="The local day that is study day 1.",
        empty="It is that of the first meal.",
    ),
    Column(
        "enrolled_at",
        "instant",
        meaning="When the first phone was enrolled.",
        empty="No phone was enrolled.",
    ),
    Column(
        "withdrawn_at",
        "instant",
        meaning="When the participant left the study.",
        empty="They are in it.",
    ),
    *MEALS,
)
