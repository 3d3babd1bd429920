"""Making and correcting foods and densities over the wire."""

import uuid
from datetime import datetime
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StrictBool, StrictInt, model_validator

from app.http.closed_model import ClosedModel
from app.http.field_descriptions import (
    ALIASES,
    DENSITY,
    DENSITY_KIND,
    DENSITY_SD,
    DENSITY_STATE,
    DENSITY_WEIGHS,
    FOOD_FORM,
    FOOD_GROUP,
    FOOD_STATE,
    IS_MIXED_DISH,
    REASON,
)
from app.http.text_schemas import Instant, Number, Text, unless_named
from app.nutrition.foods import DensityKind, FoodForm, FoodState, SliceForm, WeighedPart
from app.nutrition.plausible import MAX_G_PER_ML, MIN_G_PER_ML

NOT_BLANK = r"\S"

Reason = Annotated[
    Text,
    Field(min_length=1, max_length=1000, pattern=NOT_BLANK, description="Why, for the history."),
]
Name = Annotated[Text, Field(min_length=1, max_length=300, pattern=NOT_BLANK)]
NewKey = Annotated[
    str,
    Field(
        min_length=1,
        max_length=100,
        pattern=r"^[a-z][a-z0-9_-]*$",
        description="A letter, then letters, digits, - _",
    ),
]
AnyKey = Annotated[
    Text, Field(min_length=1, max_length=100, description="A food's key, or its published number.")
]
ComponentName = Annotated[
    Text,
    Field(
        min_length=1,
        max_length=64,
        description="The component's number or INFOODS tagname, such as VITC.",
    ),
]
Grams = Annotated[Number, Field(strict=True, ge=0.001, le=1e6)]
Density = Annotated[Number, Field(strict=True, ge=MIN_G_PER_ML, le=MAX_G_PER_ML)]
Spread = Annotated[Number, Field(strict=True, ge=0.0, le=MAX_G_PER_ML)]
Share = Annotated[Number, Field(strict=True, ge=0.0, le=1.0)]
State = Annotated[
    Text, Field(min_length=1, max_length=32, pattern=NOT_BLANK, description="Such as raw, sliced.")
]
Basis = Literal["measured", "fao", "portion", "related", "composition", "group"]


class FigureIn(ClosedModel):
    """Content of 100 g edible portion; the unit must fit the component's and is converted to it."""

    per_100_g: Annotated[Number, Field(strict=True, ge=0.0)] = Field(
        description="Content of 100 g edible portion, in `unit`."
    )
    unit: Literal["g", "mg", "ug", "kcal", "kJ", "IU"] = Field(
        description="Unit of the figure; it is converted to the component's own."
    )


class RefuseIn(ClosedModel):
    """A part that is not eaten, percent of the whole food."""

    part: Annotated[Text, Field(min_length=1, max_length=100, pattern=NOT_BLANK)] = Field(
        description="The part that is not eaten, such as core and stem."
    )
    percent: Annotated[Number, Field(strict=True, ge=0.0, lt=100.0)] = Field(
        description="Its share of the whole food's mass, percent."
    )
    is_served: StrictBool = Field(
        default=True, description="Whether it is usually still on the food in a photograph."
    )


class DensityIn(ClosedModel):
    """A density of a food with its source."""

    g_per_ml: Density = Field(description=DENSITY)
    sd_g_per_ml: Spread = Field(description=DENSITY_SD)
    state: State
    kind: DensityKind = Field(description=DENSITY_KIND)
    basis: Basis = Field(
        default="measured",
        description="How the density was obtained, from best to worst: measured, fao, portion, related, composition, "
        "group.",
    )
    source: Name = Field(description="Who measured or published it.")
    weighs: WeighedPart = Field(default="as_seen", description=DENSITY_WEIGHS)

    @model_validator(mode="after")
    def _spread_below_density(self) -> Self:
        if self.sd_g_per_ml > self.g_per_ml:
            raise ValueError("the spread is larger than the density")
        return self


class PortionIn(ClosedModel):
    """`amount` of `measure` hold mass_g of edible food."""

    amount: Grams = Field(description="How many of the measure.")
    measure: Annotated[Text, Field(min_length=1, max_length=200, pattern=NOT_BLANK)] = Field(
        description="The household measure, such as cup, sliced."
    )
    mass_g: Grams = Field(description="Grams of edible food that the portion holds.")


class IngredientIn(ClosedModel):
    """Edible grams of a food, in the state in which it goes into the dish.

    retention: component -> share that cooking leaves, with its source; none is made up, 1 where not named.
    """

    food: AnyKey
    mass_g: Grams = Field(description="Edible grams that go into the dish.")
    state: FoodState = Field(
        description="The state in which it goes into the dish: raw (dry goods too), cooked or as_eaten."
    )
    retention: Annotated[dict[ComponentName, Share], Field(max_length=300)] = Field(
        default={},
        description="Component -> share of it that cooking leaves, 0 to 1; 1 where not named.",
    )
    retention_source: Name | None = Field(
        default=None, description="Where the retention factors are from; needed with any."
    )

    @model_validator(mode="after")
    def _require_source(self) -> Self:
        if self.retention and self.retention_source is None:
            raise ValueError("retention factors need a retention_source")
        return self


class RecipeIn(ClosedModel):
    """What a dish is made of. yield_factor: its mass as eaten / that of its ingredients."""

    yield_factor: Annotated[Number, Field(strict=True, ge=0.01, le=50.0)] = Field(
        description="The dish's mass as eaten over the mass of its ingredients."
    )
    ingredients: Annotated[list[IngredientIn], Field(min_length=1, max_length=200)] = Field(
        description="What goes into the dish."
    )


class FoodFieldsIn(ClosedModel):
    """The fields of a food that can be given. What is not known of its nutrients is left out, never 0."""

    name: Name = Field(default="", json_schema_extra=unless_named, description="The food's name.")
    aliases: Annotated[list[Name], Field(max_length=100)] = Field(default=[], description=ALIASES)
    group: Text = Field(
        default="",
        min_length=1,
        max_length=100,
        pattern=NOT_BLANK,
        json_schema_extra=unless_named,
        description=FOOD_GROUP,
    )
    form: FoodForm = Field(default="whole", description=FOOD_FORM)
    slice_form: SliceForm | None = Field(
        default=None,
        description="How the method `paper` fits slices of it; null: the method decides.",
    )
    state: FoodState | None = Field(default=None, description=FOOD_STATE)
    is_mixed_dish: StrictBool = Field(default=False, description=IS_MIXED_DISH)
    refuse: Annotated[list[RefuseIn], Field(max_length=50)] = Field(
        default=[], description="Parts that are not eaten."
    )
    densities: Annotated[
        list[DensityIn], Field(max_length=100, description="All of them, the best first.")
    ] = Field(default=[])
    portions: Annotated[list[PortionIn], Field(max_length=200)] = Field(
        default=[], description="Household measures."
    )
    probes: Annotated[
        list[Annotated[str, Field(pattern=r"^[a-z][a-z_]{0,31}$")]],
        Field(
            max_length=50,
            description="What no camera sees and a participant is asked, such as fat_added.",
        ),
    ] = Field(default=[])
    source_ids: Annotated[
        dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")], Name],
        Field(max_length=50, description="Its numbers in published tables, such as sr28_ndb."),
    ] = Field(default={})
    recipe: RecipeIn | None = Field(default=None, description="The figures follow from it.")

    @model_validator(mode="after")
    def _distinct_parts(self) -> Self:
        parts = [refuse.part for refuse in self.refuse]
        if len(set(parts)) < len(parts):
            raise ValueError("refuse names a part twice")
        return self


class FoodIn(FoodFieldsIn):
    """A new food."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "key": "quark-low-fat",
                "name": "Quark, low fat",
                "group": "Dairy and Egg Products",
                "form": "in_vessel",
                "state": "as_eaten",
                "nutrients": {"ENERC_KCAL": {"per_100_g": 67, "unit": "kcal"}},
                "reason": "Asked for by the pilot study; figures from the package",
            }
        },
    )

    key: NewKey
    name: Name = Field(description="The food's name.")
    group: Annotated[Text, Field(min_length=1, max_length=100, pattern=NOT_BLANK)] = Field(
        description=FOOD_GROUP
    )
    form: FoodForm = Field(description=FOOD_FORM)
    nutrients: Annotated[dict[ComponentName, FigureIn], Field(max_length=400)] = Field(
        default={},
        description="Component -> content; a component that is left out is not known, not 0.",
    )
    reason: Reason


class FoodPatch(FoodFieldsIn):
    """Changes of a food: the fields that are named. Lists are replaced whole; nutrients are merged one by one.

    A nutrient of null is taken away: its content is not known, which is not 0. A recipe of null takes the recipe away
    and leaves the figures.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "nutrients": {"VITC": {"per_100_g": 4.6, "unit": "mg"}, "CAFFN": None},
                "reason": "Vitamin C as analysed in 2026",
            }
        },
    )

    nutrients: Annotated[dict[ComponentName, FigureIn | None], Field(max_length=400)] = Field(
        default={},
        description="Component -> content; null removes it: the content is not known. Those that are left out stay.",
    )
    reason: Reason


class SpecimenIn(ClosedModel):
    """One specimen: its volume and what it weighs."""

    volume_ml: Grams = Field(description="The specimen's volume.")
    mass_g: Grams = Field(description="The specimen's mass.")


class MeasuredDensityIn(ClosedModel):
    """A measured density: either g_per_ml and sd_g_per_ml, or the specimens, of which median and spread are taken."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "specimens": [{"volume_ml": 200, "mass_g": 168}, {"volume_ml": 250, "mass_g": 204}],
                "volume_step_ml": 10,
                "state": "raw, whole",
                "kind": "solid",
                "method": "water displacement, kitchen scale of 1 g",
                "reason": "The cultivar served in this study",
            }
        },
    )

    g_per_ml: Density | None = Field(default=None, description=DENSITY)
    sd_g_per_ml: Spread | None = Field(
        default=None, description="What the next specimen may differ by."
    )
    specimens: Annotated[list[SpecimenIn], Field(min_length=2, max_length=1000)] | None = Field(
        default=None,
        description="What was measured, one entry per specimen; instead of g_per_ml and sd_g_per_ml.",
    )
    volume_step_ml: Annotated[Number, Field(strict=True, gt=0.0, le=1e4)] = Field(
        default=1.0,
        description="To what the volumes were read: their rounding is part of the spread.",
    )
    state: State
    kind: DensityKind = Field(description=DENSITY_KIND)
    weighs: WeighedPart = Field(default="as_seen", description=DENSITY_WEIGHS)
    method: Annotated[
        Text,
        Field(min_length=1, max_length=250, pattern=NOT_BLANK, description="How it was measured."),
    ]
    reason: Reason

    @model_validator(mode="after")
    def _density_or_specimens(self) -> Self:
        computed = (self.g_per_ml is not None, self.sd_g_per_ml is not None)
        if self.specimens is None and computed != (True, True):
            raise ValueError("give g_per_ml and sd_g_per_ml, or specimens")
        if (
            self.g_per_ml is not None
            and self.sd_g_per_ml is not None
            and self.sd_g_per_ml > self.g_per_ml
        ):
            raise ValueError("the spread is larger than the density")
        if self.specimens is not None and any(computed):
            raise ValueError("give either specimens or g_per_ml and sd_g_per_ml, not both")
        return self


class StudyDensityIn(MeasuredDensityIn):
    """A study's own measurement."""

    food: AnyKey
    measured_at: Instant | None = Field(
        default=None, description="When it was measured, RFC 3339 with offset; null: now."
    )

    @model_validator(mode="after")
    def _require_offset(self) -> Self:
        if self.measured_at is not None and self.measured_at.tzinfo is None:
            raise ValueError("measured_at needs an offset, such as +08:00")
        return self


class StudyDensityOut(BaseModel):
    """A study's own measurement; it counts while withdrawn_at is null."""

    id: uuid.UUID = Field(description="The measurement's id.")
    food: str = Field(description="The food's key.")
    g_per_ml: float = Field(description=DENSITY)
    sd_g_per_ml: float = Field(description=DENSITY_SD)
    state: str = Field(description=DENSITY_STATE)
    kind: DensityKind = Field(description=DENSITY_KIND)
    weighs: WeighedPart = Field(description=DENSITY_WEIGHS)
    source: str = Field(description="Who measured it and how, as records quote it.")
    specimens: list[SpecimenIn] | None = Field(
        description="What was measured; null: the density was given as such."
    )
    author: str = Field(description="Name of the staff member who entered it.")
    reason: str = Field(description="Why it was measured, as its author wrote.")
    measured_at: datetime = Field(description="When it was measured.")
    created_at: datetime = Field(description="When it was entered.")
    withdrawn_by: str | None = Field(
        description="Name of the staff member who withdrew it; null: it is in use."
    )
    withdrawn_at: datetime | None = Field(
        description="Since when it is not used any more; null: it is in use."
    )
    withdrawal_reason: str | None = Field(description="Why it was withdrawn; null: it is in use.")


class StudyDensityList(BaseModel):
    """A study's own measurements, withdrawn ones too, the newest entry first."""

    items: list[StudyDensityOut] = Field(
        description="The study's measurements, withdrawn ones too."
    )


class WithdrawalIn(ClosedModel):
    """Why a measurement is taken out of use."""

    reason: Reason


class RestoreIn(ClosedModel):
    """Which version a food is put back to; it becomes a new version."""

    version: Annotated[StrictInt, Field(ge=1, le=1_000_000)] = Field(
        description="The version to go back to."
    )
    reason: Reason


class ChangeOut(BaseModel):
    """One change. differences: field -> [old, new]; a nutrient's field is nutrients.NUMBER; empty for a new food.

    previous_release: of the version that was changed; null for a new food.
    """

    version: int = Field(description="The version that the change made.")
    previous_version: int | None = Field(
        description="The version that was changed; null: the food was new."
    )
    previous_release: str | None = Field(
        description="The food table of the version that was changed; null: the food was new."
    )
    author: str = Field(description="Name of the staff member who made it.")
    reason: str = Field(description=REASON)
    changed_at: datetime = Field(description="When it was made.")
    differences: dict[str, tuple[object, object]] = Field(
        description="Field -> [old, new]; a nutrient's field is nutrients.NUMBER; empty for a new food."
    )


class ChangeList(BaseModel):
    """A food's changes, the newest first; a food that is as it was imported has none."""

    items: list[ChangeOut] = Field(description="The changes, the newest first.")
