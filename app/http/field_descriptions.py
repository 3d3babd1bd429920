"""Descriptions and types of fields that many answers share.

Those of tables come from the data dictionary's columns.
"""

from collections.abc import Callable, Iterable
from datetime import date, datetime
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, Field, create_model

from app.http.columns.day_columns import DAY_COLUMNS
from app.http.columns.dictionary import Column
from app.http.columns.meal_columns import PHOTOGRAPH_COLUMNS
from app.http.columns.record_columns import RECORD_COLUMNS

Model = TypeVar("Model", bound=BaseModel)


def _meaning(column: Column) -> str:
    """A column's meaning, and what null says where it can be null."""
    if column.empty is None:
        return column.meaning
    return f"{column.meaning} Null: {column.empty[0].lower()}{column.empty[1:]}"


def _by_name(columns: Iterable[Column]) -> dict[str, str]:
    return {column.name: _meaning(column) for column in columns}


def with_numbers(columns: Iterable[Column]) -> Callable[[type[Model]], type[Model]]:
    """Add a field of a number or null for each column at the end of a model."""
    fields: dict[str, Any] = {
        column.name: (float | None, Field(description=_meaning(column))) for column in columns
    }

    def extend(model: type[Model]) -> type[Model]:
        return create_model(model.__name__, __base__=model, __module__=model.__module__, **fields)

    return extend


RECORD = _by_name(RECORD_COLUMNS)
DAY = _by_name(DAY_COLUMNS)
PHOTOGRAPH = _by_name(PHOTOGRAPH_COLUMNS)

STUDY = "The study's code."
PARTICIPANT = "The participant's pseudonymous code in the study."
MEAL_ID = "The meal's id, as the phone made it; unique for the participant."
CAPTURED_AT = "When the meal was eaten, in UTC: the time of the left photograph, or as declared."
TIME_ZONE = "IANA name of the time zone where the meal was eaten, such as Asia/Shanghai."
LOCAL_DATE = (
    "The local day that the meal counts for; a study may let its days begin after midnight."
)
RECEIVED_AT = "When the first part of the meal arrived at the server."
STUDY_DAY = (
    "The day's number for the participant, 1 on their first day; null: no first day is known."
)
CHANGE_SEQ = "Grows with each change in the study: a newer change has a larger number."
FLAGS = "Known causes of doubt, by name (docs/flags.md, docs/after-meal.md)."
FOOD = "What the item is; null: not known."
SANDBOX = "Whether the study is for trying apps: its data are removed after a day and count nowhere (docs/sandbox.md)."
PAGE = "The rows of this page."
NEXT = "Path and query of the next page; null: this is the last."
EVENT_KIND = "The kind of event; it decides which other fields there are."
MEAL_VERSION = "Grows with every change of the meal; the ETag names it."
STAFF_NAME = "The staff member's name, with which they sign in."
NUMBER = "The component's number in USDA's food tables, such as 208 for energy."
REASON = "Why the change was made, as its author wrote."
FILTERS = "The filters that were set; a filter that is not named was not set."
LOCALE = "The participants' language."
PHONE_MODEL = "The phone's model as its app named it; null: not named."
APP_VERSION = "The version of the phone's app; null: not named."
DENSITY = "Density in grams per millilitre."
DENSITY_SD = "Standard deviation of the density: what the next item of this food may differ by."
DENSITY_STATE = "How the food was when it was weighed, such as raw, boiled or sliced."
DENSITY_KIND = (
    "solid: of the piece or the liquid itself. bulk: of a heap, with the air between its pieces."
)
DENSITY_WEIGHS = (
    "What the grams are of: the food as_seen, or its edible part where the source gives only that."
)
DENSITY_BASIS = (
    "How the density was obtained, from best to worst: study (measured by the study), measured, fao (FAO/INFOODS), "
    "portion (a household measure's grams), related (a similar food), composition, group (of its food group)."
)
FOOD_STATE = "raw (dry goods too), cooked or as_eaten; null: not known."
FOOD_FORM = (
    "The form in which the food usually lies on the plate; it decides how its volume is measured."
)
FOOD_GROUP = "The food group's name (GET /v1/food-groups)."
IS_MIXED_DISH = "Whether it is a dish of several foods."
ALIASES = "Other names that the search also matches."

ParticipantCode = Annotated[str, Field(description=PARTICIPANT)]
CapturedAt = Annotated[datetime, Field(description=CAPTURED_AT)]
LocalDate = Annotated[date, Field(description=LOCAL_DATE)]
Interval = Annotated[tuple[float, float] | None, Field(description="90 % interval.")]
