"""The food table: releases, foods, nutrients per 100 g edible portion, densities. Rows of a release never change."""

from datetime import date, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.models.base import Base, one_of

DENSITY_KINDS = ("solid", "bulk")


class FoodRelease(Base):
    """One import of one food table. At most one is active: that one turns new volumes into grams and nutrients."""

    __tablename__ = "food_release"

    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(100))
    version: Mapped[str] = mapped_column(sa.String(32))
    released_on: Mapped[date]
    checksum: Mapped[str] = mapped_column(sa.String(64), unique=True)
    imported_at: Mapped[datetime]
    is_active: Mapped[bool]


class Food(Base):
    """A food of one release; `key` names the same food across releases."""

    __tablename__ = "food"

    id: Mapped[int] = mapped_column(primary_key=True)
    release_id: Mapped[int] = mapped_column(sa.ForeignKey("food_release.id"))
    key: Mapped[str] = mapped_column(sa.String(100))
    name: Mapped[str] = mapped_column(sa.String(200))
    aliases: Mapped[list[Any]]
    food_group: Mapped[str] = mapped_column(sa.String(100))
    form: Mapped[str] = mapped_column(sa.String(16))
    slice_form: Mapped[str | None] = mapped_column(sa.String(16))
    refuse: Mapped[list[Any]]
    source_ids: Mapped[dict[str, Any]]

    __table_args__ = (sa.UniqueConstraint("release_id", "key"),)


class Component(Base):
    """A nutrient by its INFOODS tagname."""

    __tablename__ = "component"

    tagname: Mapped[str] = mapped_column(sa.String(16), primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(100))
    unit: Mapped[str] = mapped_column(sa.String(8))


class FoodNutrient(Base):
    """How much of a component 100 g of a food's edible portion hold. No row: not known, which is not zero."""

    __tablename__ = "food_nutrient"

    food_id: Mapped[int] = mapped_column(sa.ForeignKey("food.id"), primary_key=True)
    tagname: Mapped[str] = mapped_column(sa.ForeignKey("component.tagname"), primary_key=True)
    per_100_g: Mapped[float]


class FoodDensity(Base):
    """A food's density, g/ml, with spread, state, kind and source; `position` keeps the table's order."""

    __tablename__ = "food_density"

    food_id: Mapped[int] = mapped_column(sa.ForeignKey("food.id"), primary_key=True)
    position: Mapped[int] = mapped_column(primary_key=True)
    g_per_ml: Mapped[float]
    sd_g_per_ml: Mapped[float]
    state: Mapped[str] = mapped_column(sa.String(32))
    kind: Mapped[str] = mapped_column(sa.String(8))
    basis: Mapped[str] = mapped_column(sa.String(32))
    source: Mapped[str] = mapped_column(sa.String(300))

    __table_args__ = (one_of("kind", DENSITY_KINDS), sa.CheckConstraint("g_per_ml > 0", name="positive"))
