"""Packaged foods over the wire."""

from typing import Literal

from pydantic import BaseModel, Field

from app.foods.schemas import FoodRef, NutrientOut, PortionOut


class PackagedSourceOut(BaseModel):
    """Where the figures are from; an app that shows them names it."""

    name: Literal["Open Food Facts"] = Field(description="Whose database it is.")
    release: str = Field(description="The dump, as a food table: its name and version.")
    licence: Literal["ODbL 1.0"] = Field(
        description="Open Database License: name the source, share a changed database alike."
    )
    url: str = Field(description="The product's page.")


class PackagedFoodOut(FoodRef):
    """A packaged food. An entry takes its key, with grams or a count of its portions."""

    barcode: str = Field(description="The GTIN, with zeros before it up to 13 digits.")
    measured_in: Literal["g", "ml"] = Field(
        description="What the label's figures are of 100 of. For ml all grams are millilitres."
    )
    nutrients: list[NutrientOut] = Field(
        description="What the label has; others are not known, not 0."
    )
    portions: list[PortionOut] = Field(
        description="`pack` and `serving`, as far as their size is known."
    )
    source: PackagedSourceOut = Field(description="Where the figures are from.")
