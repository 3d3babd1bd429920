"""Foods, their nutrients and densities over the wire."""

from pydantic import BaseModel, Field

from app.http.field_descriptions import (
    ALIASES,
    DENSITY,
    DENSITY_BASIS,
    DENSITY_KIND,
    DENSITY_SD,
    DENSITY_STATE,
    DENSITY_WEIGHS,
    FOOD_FORM,
    FOOD_GROUP,
    FOOD_STATE,
    IS_MIXED_DISH,
    NUMBER,
)
from app.nutrition.foods import DensityBasis, DensityKind, FoodForm, FoodState, WeighedPart


class FoodRef(BaseModel):
    """A food by key and name."""

    key: str = Field(description="The food's key: the same through releases and versions.")
    name: str = Field(description="The food's name.")


class ComponentOut(BaseModel):
    """A component by its source's number; tagname: INFOODS, null where there is none."""

    number: str = Field(description=NUMBER)
    tagname: str | None = Field(description="INFOODS tagname, such as PROCNT; null: there is none.")
    name: str = Field(description="The component's name.")
    unit: str = Field(description="Unit of the amounts, such as g, mg or kcal.")


class NutrientAmount(ComponentOut):
    """How much of a component the edible portion holds, with its 90 % interval."""

    amount: float = Field(description="How much of it, in `unit`.")
    interval: tuple[float, float] | None = Field(
        description="The doubt about the grams, not about the food table's figures. Null where the table has a content "
        "of 0, of which the grams' doubt tells nothing."
    )


class NutrientTotal(NutrientAmount):
    """A meal's total of a component; coverage: for which share of the eaten grams it is known."""

    coverage: float | None = Field(
        description="Null where an item's mass is not known: the total is incomplete."
    )


class NutrientOut(ComponentOut):
    """Content of 100 g edible portion."""

    expression: str | None = Field(
        description="What kind of figure it is, where the name leaves a choice."
    )
    per_100_g: float = Field(description="Content of 100 g edible portion, in `unit`.")


class DensityOut(BaseModel):
    """A density with its source.

    kind: solid (the food itself) or bulk (with the air in a heap). basis: how it was come by. weighs: as_seen, or
    edible where the source gives the edible mass in a volume.
    """

    g_per_ml: float = Field(description=DENSITY)
    sd_g_per_ml: float = Field(description=DENSITY_SD)
    state: str = Field(description=DENSITY_STATE)
    kind: DensityKind = Field(description=DENSITY_KIND)
    basis: DensityBasis = Field(description=DENSITY_BASIS)
    source: str = Field(description="Who measured or published it.")
    weighs: WeighedPart = Field(description=DENSITY_WEIGHS)


class RejectedDensityOut(DensityOut):
    """A density that was not chosen, and why."""

    reason: str = Field(description="Why it was not chosen.")


class DensityChoiceOut(BaseModel):
    """The density that turns a volume of this food into grams, why, and what it was chosen over, best first."""

    chosen: DensityOut = Field(description="The density that is used.")
    reason: str = Field(description="Why it was chosen.")
    alternatives: list[RejectedDensityOut] = Field(description="The other densities, best first.")


class PortionOut(BaseModel):
    """A household measure; mass_g: of edible food."""

    amount: float = Field(description="How many of the measure.")
    measure: str = Field(description="The household measure, such as cup, sliced.")
    mass_g: float = Field(description="Grams of edible food that the portion holds.")


class RefuseOut(BaseModel):
    """A part that is not eaten, percent of the whole food; is_served: usually still on it in a photograph."""

    part: str = Field(description="The part that is not eaten, such as core and stem.")
    percent: float = Field(description="Its share of the whole food's mass, percent.")
    is_served: bool = Field(description="Whether it is usually still on the food in a photograph.")


class FoodSummary(FoodRef):
    """A food in a list."""

    aliases: list[str] = Field(description=ALIASES)
    group: str = Field(description=FOOD_GROUP)
    form: FoodForm = Field(description=FOOD_FORM)


class IngredientOut(FoodRef):
    """An ingredient: this version of a food, edible grams. is_current: the food has not been corrected since.

    retention: component number -> share that cooking leaves; 1 where not named.
    """

    version: int = Field(description="The food's version that the recipe holds.")
    state: FoodState | None = Field(description=FOOD_STATE)
    mass_g: float = Field(description="Edible grams that go into the dish.")
    retention: dict[str, float] = Field(
        description="Component number -> share of it that cooking leaves, 0 to 1; 1 where not named."
    )
    retention_source: str | None = Field(
        description="Where the retention factors are from; null: there are none."
    )
    is_current: bool = Field(
        description="Whether the food has not been corrected or replaced since."
    )


class UnknownComponentOut(ComponentOut):
    """A component that some ingredients lack, so that the dish has no figure."""

    coverage: float = Field(description="For which share of the ingredients' mass it is known.")


class RecipeOut(BaseModel):
    """What a dish is made of. yield_factor: its mass as eaten / that of its ingredients."""

    yield_factor: float = Field(
        description="The dish's mass as eaten over the mass of its ingredients."
    )
    ingredients: list[IngredientOut] = Field(description="What goes into the dish.")
    unknown: list[UnknownComponentOut] = Field(
        description="Components that some ingredients lack, so that the dish has no figure."
    )


class FoodOut(FoodSummary):
    """A food with all that the tables in force know of it; a component that is not listed is not known, not 0."""

    version: int = Field(
        description="The food's version in its table's release: above 1, it was corrected."
    )
    state: FoodState | None = Field(description=FOOD_STATE)
    is_mixed_dish: bool = Field(description=IS_MIXED_DISH)
    refuse: list[RefuseOut] = Field(description="Parts that are not eaten.")
    edible_share: float = Field(description="Of an item as it is usually seen.")
    probes: list[str] = Field(description="What no camera sees and a participant is asked.")
    source_ids: dict[str, str] = Field(
        description="Its numbers in published tables, such as sr28_ndb."
    )
    release: str = Field(description="The food table's name and version.")
    densities: list[DensityOut] = Field(
        description="Its own. The choice has those of the same food elsewhere too."
    )
    density: DensityChoiceOut | None = Field(
        description="The density that turns a volume into grams; null: none is known."
    )
    nutrients: list[NutrientOut] = Field(description="Contents of 100 g edible portion.")
    portions: list[PortionOut] = Field(description="Household measures.")
    recipe: RecipeOut | None = Field(description="Null for a food that was not made from one.")


class FoodMatch(FoodSummary):
    """A food in a list, and why it is there."""

    state: FoodState | None = Field(
        description="raw (dry goods too), cooked or as_eaten; null: not told."
    )
    is_mixed_dish: bool = Field(description=IS_MIXED_DISH)
    release: str = Field(description="The food table that it is of, and its version.")
    matched: str | None = Field(
        description="The name, alias or code that the words were found in; null without words."
    )


class FoodList(BaseModel):
    """Foods, best match first."""

    items: list[FoodMatch] = Field(description="The foods, best match first.")


class FoodGroupOut(BaseModel):
    """A food group and how many foods it has, over all tables in force."""

    name: str = Field(description=FOOD_GROUP)
    foods: int = Field(description="How many foods it has.")


class FoodGroupList(BaseModel):
    """Food groups by name."""

    items: list[FoodGroupOut] = Field(description="The groups by name.")
