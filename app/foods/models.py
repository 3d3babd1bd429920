"""The food table: releases, foods, nutrients per 100 g edible portion, densities, portions, recipes, and their changes.

Rows of a release never change. A correction is a new version of a food in the release "local",
which takes precedence over all imported ones. The newest FoodActivation of a table's name decides
which of its releases is in force.
"""

import uuid
from datetime import date, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, one_of
from app.db.columns import (
    FoodRef,
    IntKey,
    LongStr,
    Str8,
    Str16,
    Str32,
    Str64,
    Str100,
    Str200,
    Str300,
    StudyRef,
    UuidKey,
    Version,
)
from app.nutrition.foods import (
    DENSITY_KINDS,
    WEIGHED_PARTS,
    DensityBasis,
    DensityKind,
    FoodForm,
    FoodState,
    SliceForm,
    WeighedPart,
)


class FoodRelease(Base):
    """One import of one published food table, or the table of local corrections.

    source: the format it was read from. checksum: of the files that were read. An unfinished or
    interrupted import has no completed_at and is never in force; written_at is the time of its last
    batch, written by importer_id.
    """

    __tablename__ = "food_release"

    id: Mapped[IntKey]
    source: Mapped[Str32]
    name: Mapped[Str100]
    version: Mapped[Str32]
    released_on: Mapped[date]
    checksum: Mapped[Str64] = mapped_column(unique=True)
    imported_at: Mapped[datetime]
    importer_id: Mapped[uuid.UUID | None]
    written_at: Mapped[datetime | None]
    completed_at: Mapped[datetime | None]

    @property
    def title(self) -> str:
        """Return name and version."""
        return f"{self.name} {self.version}"


class FoodActivation(Base):
    """Puts a release in force for its name; the newest row of a name counts."""

    __tablename__ = "food_activation"

    id: Mapped[IntKey]
    name: Mapped[Str100]
    # NULL: none of this name
    release_id: Mapped[int | None] = mapped_column(sa.ForeignKey("food_release.id"))
    author: Mapped[Str200]
    activated_at: Mapped[datetime]

    __table_args__ = (sa.Index(None, "name", "id"),)


class Food(Base):
    """One version of a food of one release; `key` names the same food across releases and versions.

    superseded_by_id: the version that corrected it; the only column that is ever set later.
    """

    __tablename__ = "food"

    id: Mapped[IntKey]
    release_id: Mapped[int] = mapped_column(sa.ForeignKey("food_release.id"))
    key: Mapped[Str100]
    version: Mapped[Version]
    name: Mapped[Str300]
    aliases: Mapped[list[str]]
    food_group: Mapped[Str100]
    form: Mapped[FoodForm] = mapped_column(sa.String(16))
    slice_form: Mapped[SliceForm | None] = mapped_column(sa.String(16))
    state: Mapped[FoodState | None] = mapped_column(sa.String(16))
    is_mixed_dish: Mapped[bool] = mapped_column(default=False)
    refuse: Mapped[list[Any]]
    probes: Mapped[list[str]]
    recipe_yield: Mapped[float | None]  # prepared mass / mass of the ingredients; NULL: no recipe
    source_ids: Mapped[dict[str, str]]
    superseded_by_id: Mapped[FoodRef | None] = mapped_column(index=True)

    @property
    def is_group(self) -> bool:
        """Return whether it stands for several foods (docs/food-table.md)."""
        return "members" in self.source_ids

    __table_args__ = (
        sa.UniqueConstraint("release_id", "key", "version"),
        sa.Index(None, "key"),
        sa.Index(None, "release_id", "food_group"),
    )


class Component(Base):
    """A nutrient.

    number: its source's number (nutrition/components.py); tagname: INFOODS, if it has one.
    """

    __tablename__ = "component"

    id: Mapped[IntKey]
    number: Mapped[Str16] = mapped_column(unique=True)
    name: Mapped[Str200]
    unit: Mapped[Str8]
    tagname: Mapped[Str16 | None]
    expression: Mapped[Str100 | None]


class FoodNutrient(Base):
    """Content of a component in 100 g of a food's edible portion.

    No row means not known, which is not zero.
    """

    __tablename__ = "food_nutrient"

    food_id: Mapped[FoodRef] = mapped_column(primary_key=True)
    component_id: Mapped[int] = mapped_column(sa.ForeignKey("component.id"), primary_key=True)
    per_100_g: Mapped[float]


class FoodDensity(Base):
    """A food's density, g/ml, with spread, state, kind and source; `position` keeps the table's order."""

    __tablename__ = "food_density"

    food_id: Mapped[FoodRef] = mapped_column(primary_key=True)
    position: Mapped[IntKey]
    g_per_ml: Mapped[float]
    sd_g_per_ml: Mapped[float]
    state: Mapped[Str32]
    kind: Mapped[DensityKind] = mapped_column(sa.String(8))
    basis: Mapped[DensityBasis] = mapped_column(sa.String(32))
    source: Mapped[Str300]
    weighs: Mapped[WeighedPart] = mapped_column(sa.String(8))

    __table_args__ = (
        one_of("kind", DENSITY_KINDS),
        one_of("weighs", WEIGHED_PARTS),
        sa.CheckConstraint("g_per_ml > 0", name="positive"),
    )


class FoodPortion(Base):
    """A household measure of a food; mass_g: edible mass; sequence: its number in the source."""

    __tablename__ = "food_portion"

    food_id: Mapped[FoodRef] = mapped_column(primary_key=True)
    position: Mapped[IntKey]
    sequence: Mapped[Str32]
    amount: Mapped[float]
    measure: Mapped[Str200]
    mass_g: Mapped[float]


class FoodIngredient(Base):
    """An ingredient of a recipe: a version of a food, its mass, and the share of each component left after cooking."""

    __tablename__ = "food_ingredient"

    food_id: Mapped[FoodRef] = mapped_column(primary_key=True)
    position: Mapped[IntKey]
    ingredient_id: Mapped[FoodRef] = mapped_column(index=True)
    mass_g: Mapped[float]
    retention: Mapped[dict[str, float]]  # component number -> share; 1 where not named
    retention_source: Mapped[Str300 | None]


class FoodChange(Base):
    """The author, time and reason of a version of a food, and its differences from the previous one: [old, new]."""

    __tablename__ = "food_change"

    food_id: Mapped[FoodRef] = mapped_column(primary_key=True)
    previous_id: Mapped[FoodRef | None] = mapped_column(index=True)
    author: Mapped[Str200]
    reason: Mapped[LongStr]
    differences: Mapped[dict[str, list[object]]]
    changed_at: Mapped[datetime]


class StudyDensity(Base):
    """A study's own measurement of a food's density, which takes precedence in that study.

    Withdrawn, never deleted.

    specimens: [volume_ml, mass_g] of each specimen; NULL if the density was entered directly.
    """

    __tablename__ = "study_density"

    id: Mapped[UuidKey]
    study_id: Mapped[StudyRef]
    food_key: Mapped[Str100]
    g_per_ml: Mapped[float]
    sd_g_per_ml: Mapped[float]
    state: Mapped[Str32]
    kind: Mapped[DensityKind] = mapped_column(sa.String(8))
    weighs: Mapped[WeighedPart] = mapped_column(sa.String(8))
    source: Mapped[Str300]
    specimens: Mapped[list[list[float]] | None]
    author: Mapped[Str200]
    reason: Mapped[LongStr]
    measured_at: Mapped[datetime]
    created_at: Mapped[datetime]
    withdrawn_by: Mapped[Str200 | None]
    withdrawn_at: Mapped[datetime | None]
    withdrawal_reason: Mapped[LongStr | None]

    __table_args__ = (
        one_of("kind", DENSITY_KINDS),
        one_of("weighs", WEIGHED_PARTS),
        sa.CheckConstraint("g_per_ml > 0", name="positive"),
        sa.Index(None, "study_id", "food_key"),
    )
