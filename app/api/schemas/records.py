"""Records over the wire."""

import uuid
from datetime import date, datetime

from pydantic import BaseModel, Field

from app.api.schemas.foods import FoodRef


class RecordOfItem(BaseModel):
    """What holds for one item now. What is not known is null, never 0.

    That is a component that the food table lacks, and all that follows from a volume that could not be measured.
    """

    id: uuid.UUID = Field(description="The item's id.")
    meal_id: uuid.UUID
    study: str
    participant: str
    captured_at: datetime
    time_zone: str
    local_date: date
    upload_delay_seconds: float = Field(description="From eating to the first of the meal on the server.")
    status: str
    origin: str
    provisional: bool
    reviewed: bool
    food: FoodRef | None
    food_table: str | None
    volume_ml: float | None = Field(description="Null where it could not be measured: a person must set an amount.")
    volume_low_ml: float | None
    volume_high_ml: float | None
    density_g_per_ml: float | None = Field(
        description="Turned the volume into grams; null where a person set the grams."
    )
    density_source: str | None
    mass_g: float | None
    mass_low_g: float | None
    mass_high_g: float | None
    edible_g: float | None = Field(description="As served, without peel, core and bone.")
    share: float = Field(description="The participant's share of a dish that is shared.")
    left_g: float | None = Field(description="Edible grams left over; null: nobody has looked.")
    consumed_g: float | None = Field(description="(edible - left) x share: the components are of it. Signed.")
    consumed_low_g: float | None
    consumed_high_g: float | None
    energy_kcal: float | None
    protein_g: float | None
    fat_g: float | None
    carbohydrate_g: float | None
    fibre_g: float | None
    sugar_g: float | None
    saturated_fat_g: float | None
    sodium_mg: float | None
    potassium_mg: float | None
    vitamin_c_mg: float | None
    nutrient_intervals: dict[str, tuple[float, float] | None] = Field(
        description="The 90 % interval of each component's amount, by its name: the doubt about the grams, not about "
        "the food table's figures. Null where the amount is not known, and where the table has a content of 0."
    )
    flags: list[str]
    change_seq: int


class RecordOut(RecordOfItem):
    """The same with what is known of its day when it is asked for."""

    day_status: str = Field(description="closed: all that was eaten on the day is told; open: leave it out of means.")
    study_day: int | None = Field(description="1 on the participant's first day.")


class RecordPage(BaseModel):
    """A page of records in the order of capture; `next` leads to the page after it, null at the end."""

    items: list[RecordOut]
    next: str | None = Field(description="The next page's path and query.")
