"""Records, foods and their parts over the wire."""

import uuid
from datetime import date, datetime

from pydantic import BaseModel, Field


class FoodRef(BaseModel):
    """A food by key and name."""

    key: str
    name: str


class NutrientAmount(BaseModel):
    """How much of a component the edible portion holds; tagname: INFOODS."""

    tagname: str
    name: str
    unit: str
    amount: float


class RecordOut(BaseModel):
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
    status: str
    food: FoodRef | None
    food_table: str | None
    volume_ml: float | None = Field(description="Null where it could not be measured: a person must set an amount.")
    volume_low_ml: float | None
    volume_high_ml: float | None
    density_g_per_ml: float | None
    density_source: str | None
    mass_g: float | None
    mass_low_g: float | None
    mass_high_g: float | None
    edible_g: float | None
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
    change_seq: int


class RecordPage(BaseModel):
    """A page of records in the order of capture; `next` leads to the page after it, null at the end."""

    items: list[RecordOut]
    next: str | None = Field(description="The next page's path and query.")


class NutrientOut(BaseModel):
    """Content of 100 g edible portion."""

    tagname: str
    name: str
    unit: str
    per_100_g: float


class DensityOut(BaseModel):
    """A density with its source; kind: solid (the food itself) or bulk (with the air in a heap)."""

    g_per_ml: float
    sd_g_per_ml: float
    state: str
    kind: str
    basis: str
    source: str


class FoodSummary(FoodRef):
    """A food in a list."""

    aliases: list[str]
    group: str
    form: str


class FoodOut(FoodSummary):
    """A food with all that the table knows of it; a component that is not listed is not known."""

    refuse: list[dict[str, object]]
    source_ids: dict[str, object]
    release: str
    densities: list[DensityOut]
    nutrients: list[NutrientOut]


class FoodList(BaseModel):
    """Foods, best match first."""

    items: list[FoodSummary]
