"""Records and outlines over the wire.

An outline is one ring of corners, as an app draws it, or several rings, as the server gives it.
"""

import uuid
from datetime import date, datetime
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, Discriminator, Field, Tag

from app.foods.schemas import FoodRef
from app.http.closed_model import ClosedModel
from app.http.columns.record_columns import AMOUNTS_OF_HEADLINES
from app.http.field_descriptions import CHANGE_SEQ, FLAGS, FOOD, RECORD, with_numbers
from app.http.page_of import PageOf
from app.http.text_schemas import JsonNumber
from app.meals.stored.event_models import DayStatus
from app.meals.stored.record_models import ItemOrigin, RecordStatus

MOST_RINGS = 500
MOST_CORNERS = 10_000  # of all rings together: the rings of many merged items too
MIN_CORNERS = 3  # of a ring that encloses something

Pixel = Annotated[JsonNumber, Field(ge=-1e6, le=1e6)]
Corners = Annotated[list[tuple[Pixel, Pixel]], Field(min_length=1)]


def _depth(value: Any) -> str:
    try:
        return "rings" if isinstance(value[0][0], list | tuple) else "ring"
    except (TypeError, IndexError, KeyError):
        return "ring"


def _few_corners(value: Any) -> Any:
    rings = value if _depth(value) == "rings" else [value]
    if sum(len(ring) for ring in rings) > MOST_CORNERS:
        raise ValueError(f"must have at most {MOST_CORNERS} corners in all its rings")
    return value


def _some_area(rings: list[Corners]) -> list[Corners]:
    """Refuse rings that all enclose nothing. Some may: an item's outline is accepted as the server gives it."""
    if all(len(ring) < MIN_CORNERS for ring in rings):
        raise ValueError(f"must have a ring of {MIN_CORNERS} corners or more")
    return rings


Ring = Annotated[list[tuple[Pixel, Pixel]], Field(min_length=MIN_CORNERS, max_length=MOST_CORNERS)]
Rings = Annotated[
    list[Corners], Field(min_length=1, max_length=MOST_RINGS), AfterValidator(_some_area)
]
Polygon = Annotated[
    Annotated[Ring, Tag("ring")] | Annotated[Rings, Tag("rings")],
    Discriminator(_depth),
    AfterValidator(_few_corners),
    Field(
        description="Corners x, y in the left photograph's upright pixels: one ring, or a list of rings as an item's "
        "`polygon` is given, holes by the even-odd rule."
    ),
]


class PlaceIn(ClosedModel):
    """Where a food is in the left photograph, upright pixels."""

    point: tuple[Pixel, Pixel] | None = Field(default=None, description="x, y")
    box: tuple[Pixel, Pixel, Pixel, Pixel] | None = Field(
        default=None, description="x, y, width, height"
    )
    polygon: Polygon | None = Field(
        default=None,
        description="Corners [x, y] of its outline, or a list of such rings with holes by the even-odd rule.",
    )


@with_numbers(AMOUNTS_OF_HEADLINES)
class RecordAmounts(BaseModel):
    """An item's record up to its headline components."""

    id: uuid.UUID = Field(description="The item's id.")
    meal_id: uuid.UUID = Field(description=RECORD["meal_id"])
    study: str = Field(description=RECORD["study"])
    participant: str = Field(description=RECORD["participant"])
    captured_at: datetime = Field(description=RECORD["captured_at"])
    time_zone: str = Field(description=RECORD["time_zone"])
    local_date: date = Field(description=RECORD["local_date"])
    upload_delay_seconds: float = Field(
        description="From eating to the first of the meal on the server."
    )
    status: RecordStatus = Field(description=RECORD["status"])
    origin: ItemOrigin = Field(description=RECORD["origin"])
    provisional: bool = Field(description=RECORD["provisional"])
    reviewed: bool = Field(description=RECORD["reviewed"])
    food: FoodRef | None = Field(description=FOOD)
    food_table: str | None = Field(description=RECORD["food_table"])
    volume_ml: float | None = Field(
        description="Null where it could not be measured: a person must set an amount."
    )
    volume_low_ml: float | None = Field(description=RECORD["volume_low_ml"])
    volume_high_ml: float | None = Field(description=RECORD["volume_high_ml"])
    density_g_per_ml: float | None = Field(
        description="Turned the volume into grams; null where a person set the grams."
    )
    density_source: str | None = Field(description=RECORD["density_source"])
    mass_g: float | None = Field(description=RECORD["mass_g"])
    mass_low_g: float | None = Field(description=RECORD["mass_low_g"])
    mass_high_g: float | None = Field(description=RECORD["mass_high_g"])
    edible_g: float | None = Field(description="As served, without peel, core and bone.")
    share: float = Field(description="The participant's share of a dish that is shared.")
    left_g: float | None = Field(description="Edible grams left over; null: nobody has looked.")
    consumed_g: float | None = Field(
        description="(edible - left) x share: the components are of it. Signed."
    )
    consumed_low_g: float | None = Field(description=RECORD["consumed_low_g"])
    consumed_high_g: float | None = Field(description=RECORD["consumed_high_g"])


class RecordOfItem(RecordAmounts):
    """What holds for one item now. What is not known is null, never 0.

    That is a component that the food table lacks, and all that follows from a volume that could not be measured.
    """

    nutrient_intervals: dict[str, tuple[float, float] | None] = Field(
        description="The 90 % interval of each component's amount, by its name: the doubt about the grams, not about "
        "the food table's figures. Null where the amount is not known, and where the table has a content of 0."
    )
    flags: list[str] = Field(description=FLAGS)
    change_seq: int = Field(description=CHANGE_SEQ)


class RecordOut(RecordOfItem):
    """The same with what is known of its day when it is asked for."""

    day_status: DayStatus = Field(
        description="closed: all that was eaten on the day is told; open: leave it out of means."
    )
    study_day: int | None = Field(description="1 on the participant's first day.")


class RecordPage(PageOf[RecordOut]):
    """A page of records in the order of capture; `next` leads to the page after it, null at the end."""

    next: str | None = Field(description="The next page's path and query.")
