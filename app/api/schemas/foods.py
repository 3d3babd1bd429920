"""Foods, their nutrients and densities over the wire."""

from pydantic import BaseModel, Field


class FoodRef(BaseModel):
    """A food by key and name."""

    key: str
    name: str


class ComponentOut(BaseModel):
    """A component by its source's number; tagname: INFOODS, null where there is none."""

    number: str
    tagname: str | None
    name: str
    unit: str


class NutrientAmount(ComponentOut):
    """How much of a component the edible portion holds, with its 90 % interval."""

    amount: float
    interval: tuple[float, float] | None = Field(
        description="The doubt about the grams, not about the food table's figures. Null where the table has a content "
        "of 0, of which the grams' doubt tells nothing."
    )


class NutrientTotal(NutrientAmount):
    """A meal's total of a component; coverage: for which share of the eaten grams it is known."""

    coverage: float | None = Field(description="Null where an item's mass is not known: the total is incomplete.")


class NutrientOut(ComponentOut):
    """Content of 100 g edible portion."""

    expression: str | None = Field(description="What kind of figure it is, where the name leaves a choice.")
    per_100_g: float


class DensityOut(BaseModel):
    """A density with its source.

    kind: solid (the food itself) or bulk (with the air in a heap). basis: how it was come by. weighs: as_seen, or
    edible where the source gives the edible mass in a volume.
    """

    g_per_ml: float
    sd_g_per_ml: float
    state: str
    kind: str
    basis: str
    source: str
    weighs: str


class RejectedDensityOut(DensityOut):
    """A density that was not chosen, and why."""

    reason: str


class DensityChoiceOut(BaseModel):
    """The density that turns a volume of this food into grams, why, and what it was chosen over, best first."""

    chosen: DensityOut
    reason: str
    alternatives: list[RejectedDensityOut]


class PortionOut(BaseModel):
    """A household measure; mass_g: of edible food."""

    amount: float
    measure: str
    mass_g: float


class RefuseOut(BaseModel):
    """A part that is not eaten, percent of the whole food; is_served: usually still on it in a photograph."""

    part: str
    percent: float
    is_served: bool


class FoodSummary(FoodRef):
    """A food in a list."""

    aliases: list[str]
    group: str
    form: str


class IngredientOut(FoodRef):
    """An ingredient: this version of a food, edible grams. is_current: the food has not been corrected since.

    retention: component number -> share that cooking leaves; 1 where not named.
    """

    version: int
    state: str | None
    mass_g: float
    retention: dict[str, float]
    retention_source: str | None
    is_current: bool


class UnknownComponentOut(ComponentOut):
    """A component that some ingredients lack, so that the dish has no figure."""

    coverage: float = Field(description="For which share of the ingredients' mass it is known.")


class RecipeOut(BaseModel):
    """What a dish is made of. yield_factor: its mass as eaten / that of its ingredients."""

    yield_factor: float
    ingredients: list[IngredientOut]
    unknown: list[UnknownComponentOut]


class FoodOut(FoodSummary):
    """A food with all that the tables in force know of it; a component that is not listed is not known, not 0."""

    version: int
    state: str | None
    is_mixed_dish: bool
    refuse: list[RefuseOut]
    edible_share: float = Field(description="Of an item as it is usually seen.")
    probes: list[str] = Field(description="What no camera sees and a participant is asked.")
    source_ids: dict[str, str]
    release: str
    densities: list[DensityOut] = Field(description="Its own. The choice has those of the same food elsewhere too.")
    density: DensityChoiceOut | None
    nutrients: list[NutrientOut]
    portions: list[PortionOut]
    recipe: RecipeOut | None = Field(description="Null for a food that was not made from one.")


class FoodMatch(FoodSummary):
    """A food in a list, and why it is there."""

    state: str | None = Field(description="raw (dry goods too), cooked or as_eaten; null: not told.")
    is_mixed_dish: bool
    release: str = Field(description="The food table that it is of, and its version.")
    matched: str | None = Field(description="The name, alias or code that the words were found in; null without words.")


class FoodList(BaseModel):
    """Foods, best match first."""

    items: list[FoodMatch]


class FoodGroupOut(BaseModel):
    """A food group and how many foods it has, over all tables in force."""

    name: str
    foods: int


class FoodGroupList(BaseModel):
    """Food groups by name."""

    items: list[FoodGroupOut]
