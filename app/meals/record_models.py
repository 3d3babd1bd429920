"""What the pipeline found and what it was taken for, append-only; the effective record of each item, a projection."""

import uuid
from datetime import date, datetime
from typing import Any, Literal, TypedDict, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, BlobColumns, JsonValue, Personal, one_of
from app.meals.event_models import LAYERS
from app.meals.job_models import JOB_PURPOSES
from app.nutrition.doubt import Estimate
from app.nutrition.nutrients import interval_in_proportion

HEADLINE_COLUMNS = (  # the components that a record holds itself, units in their names
    "energy_kcal",
    "protein_g",
    "fat_g",
    "carbohydrate_g",
    "fibre_g",
    "sugar_g",
    "saturated_fat_g",
    "sodium_mg",
    "potassium_mg",
    "vitamin_c_mg",
)
RecordStatus = Literal["proposed", "needs_review", "confirmed", "corrected", "rejected"]
RECORD_STATUSES: tuple[RecordStatus, ...] = get_args(RecordStatus)
ItemOrigin = Literal["pipeline", "after", "declared", "added", "split", "merged"]
ITEM_ORIGINS: tuple[ItemOrigin, ...] = get_args(ItemOrigin)
LeftoverClass = Literal["food_left", "refuse", "unmatched"]
CandidateSource = Literal["hint", "index"]  # the phone's hint, or the index of looks
LEFTOVER_CLASSES: tuple[LeftoverClass, ...] = get_args(LeftoverClass)


class MassDoubt(TypedDict):
    """Edible grams as one term of a meal's total, with their relative standard deviation by part."""

    edible_g: float
    pair: float
    density: float
    item: float


class RecordDetails(TypedDict):
    """What a reader of the meal needs beside a record's columns.

    rings: the region as it stands; None: the item's own. served, left: the terms of the meal's totals; left: of each
    piece that was left over. open_probes: of its food, those that nobody has answered.
    """

    rings: list[Any] | None
    served: MassDoubt | None
    left: list[MassDoubt]
    open_probes: list[str]


class Run(Base):
    """One execution of the pipeline on a meal. Never updated: a new execution is a new run. id: the job's id.

    purpose: the job's. Only a run for "meal" makes the meal's items.
    """

    __tablename__ = "run"
    personal = Personal(("meal_id",), "runs", order_by="created_at")
    blob = BlobColumns("result_key")

    id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("job.id"), primary_key=True)
    meal_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("meal.id"), index=True)
    purpose: Mapped[str] = mapped_column(sa.String(16), default="meal")
    method: Mapped[str] = mapped_column(sa.String(32))
    pipeline_version: Mapped[str] = mapped_column(sa.String(32))
    marker: Mapped[str] = mapped_column(sa.String(64))
    camera: Mapped[dict[str, Any] | None]
    parameters: Mapped[dict[str, Any]]
    colour: Mapped[dict[str, Any] | None]  # each photograph's colour correction by the marker
    stages: Mapped[dict[str, Any]]
    seconds: Mapped[float]
    food_releases: Mapped[list[Any]]  # the tables in force, "name version", the one that goes first at the head
    failure_code: Mapped[str | None] = mapped_column(sa.String(64))
    failure_message: Mapped[str | None] = mapped_column(sa.Text)
    result_key: Mapped[str] = mapped_column(sa.String(300), unique=True)  # the pipeline's whole answer, in the store
    created_at: Mapped[datetime]

    __table_args__ = (one_of("purpose", JOB_PURPOSES),)


class RunArtefact(Base):
    """A picture or point cloud of a run's step, in the blob store."""

    __tablename__ = "run_artefact"
    personal = Personal(("run_id",), "derived_pictures")
    blob = BlobColumns()

    run_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("run.id"), primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(64), primary_key=True)
    media_type: Mapped[str] = mapped_column(sa.String(64))
    bytes: Mapped[int] = mapped_column(sa.BigInteger)
    sha256: Mapped[str] = mapped_column(sa.String(64))
    blob_key: Mapped[str] = mapped_column(sa.String(300), unique=True)


class Item(Base):
    """One food of a meal: found by a run, or told by a person; its outline, its volume and the doubt about it.

    origin: "pipeline", found in the meal's pair; "after", found in the after-meal pair (food left, or refuse);
    "declared", told and never seen; "added", seen by a person and not by the pipeline; "split" and "merged", made from
    other items by event_id. Without a volume (flag "not_measurable", or a person told grams) the interval is NULL too,
    and relative_sd empty. traits: what leftovers are matched by (where it stood, its colour). parent_id: the item that
    it was split from, or that a declared one answers a probe of.
    """

    __tablename__ = "item"
    personal = Personal(("meal_id",), "items", order_by="position")

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    meal_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("meal.id"), index=True)
    run_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("run.id"))
    origin: Mapped[ItemOrigin] = mapped_column(sa.String(16), default="pipeline")
    parent_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("item.id"), index=True)
    event_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("meal_event.id"), index=True)
    position: Mapped[int]
    rings: Mapped[list[Any]]
    volume_ml: Mapped[float | None]
    volume_low_ml: Mapped[float | None]
    volume_high_ml: Mapped[float | None]
    relative_sd: Mapped[dict[str, Any]]
    flags: Mapped[list[Any]]
    traits: Mapped[dict[str, Any]] = mapped_column(default=dict)

    __table_args__ = (
        sa.UniqueConstraint("run_id", "position"),
        one_of("origin", ITEM_ORIGINS),
        sa.CheckConstraint("(run_id IS NULL) = (origin NOT IN ('pipeline', 'after'))", name="run_of_what_it_found"),
        sa.CheckConstraint(
            "(volume_ml IS NULL) = (volume_low_ml IS NULL) AND (volume_ml IS NULL) = (volume_high_ml IS NULL)",
            name="volume_with_interval",
        ),
    )


class ItemMeasure(Base):
    """An item's region measured again, as a person drew it; append-only, the one of the newest event that counts holds.

    Where the run could not measure it the volume is NULL and flags say why.
    """

    __tablename__ = "item_measure"
    personal = Personal(("item_id",), "measured_again")

    item_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("item.id"), primary_key=True)
    event_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("meal_event.id"), primary_key=True, index=True)
    run_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("run.id"), index=True)
    rings: Mapped[list[Any]]
    volume_ml: Mapped[float | None]
    volume_low_ml: Mapped[float | None]
    volume_high_ml: Mapped[float | None]
    relative_sd: Mapped[dict[str, Any]]
    flags: Mapped[list[Any]]


class Leftover(Base):
    """What an item of the after-meal pair is: food left of an item, refuse of it, or nobody knows of which.

    Append-only: the highest version of the highest layer holds. event_id: who said so; NULL: matched by the server.
    """

    __tablename__ = "leftover"
    personal = Personal(("after_item_id", "item_id"), "leftovers")

    after_item_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("item.id"), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    item_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("item.id"), index=True)
    leftover_class: Mapped[LeftoverClass] = mapped_column(sa.String(16))
    layer: Mapped[str] = mapped_column(sa.String(16), default="automatic")
    event_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("meal_event.id"), index=True)
    flags: Mapped[list[Any]]
    created_at: Mapped[datetime]

    __table_args__ = (
        one_of("leftover_class", LEFTOVER_CLASSES),
        one_of("layer", LAYERS),
        sa.CheckConstraint("(item_id IS NULL) = (leftover_class = 'unmatched')", name="matched_to_an_item"),
    )


class ItemCandidate(Base):
    """A food that an item may be; source tells who says so: the phone's "hint" or the "index".

    Append-only: positions go on where a later run identifies the item again, and its candidates hold; best first in
    each run. run_id: NULL, the run that found the item. probability: NULL, a hint's.
    """

    __tablename__ = "item_candidate"
    personal = Personal(("item_id",), "candidates")

    item_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("item.id"), primary_key=True)
    position: Mapped[int] = mapped_column(primary_key=True)
    food_id: Mapped[int] = mapped_column(sa.ForeignKey("food.id"))
    probability: Mapped[float | None]
    source: Mapped[CandidateSource] = mapped_column(sa.String(16))
    run_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("run.id"), index=True)


class ItemFood(Base):
    """Which food an item is taken for, and what turns its volume into grams; append-only.

    The highest version of the highest layer holds, but for those whose event was undone. The density and the edible
    share are kept as they were chosen, so that a record can always be built again. Without a density (the table knows
    none) the density's columns are NULL. recompute_id: the recomputation that wrote it.
    """

    __tablename__ = "item_food"
    personal = Personal(("item_id",), "taken_for", order_by="version")

    item_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("item.id"), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    food_id: Mapped[int] = mapped_column(sa.ForeignKey("food.id"))
    lies_as: Mapped[str | None] = mapped_column(sa.String(16))  # its form on the plate; NULL: as it usually lies
    density_g_per_ml: Mapped[float | None]
    density_sd_g_per_ml: Mapped[float | None]
    density_state: Mapped[str | None] = mapped_column(sa.String(32))
    density_kind: Mapped[str | None] = mapped_column(sa.String(8))
    density_basis: Mapped[str | None] = mapped_column(sa.String(32))
    density_source: Mapped[str | None] = mapped_column(sa.String(300))
    density_weighs: Mapped[str | None] = mapped_column(sa.String(8))
    edible_share: Mapped[float]
    layer: Mapped[str] = mapped_column(sa.String(16), default="automatic")
    event_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("meal_event.id"), index=True)
    recompute_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("recompute.id"))
    created_at: Mapped[datetime]

    __table_args__ = (one_of("layer", LAYERS),)


class Recompute(Base):
    """One `tada records recompute --nutrients`: who, when, why, and how many records changed."""

    __tablename__ = "recompute"

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    author: Mapped[str] = mapped_column(sa.String(200))
    reason: Mapped[str] = mapped_column(sa.Text)
    food_releases: Mapped[list[Any]]
    started_at: Mapped[datetime]


class EffectiveRecord(Base):
    """What holds for an item now: food, grams, ten headline components. Rebuilt from runs and events at any time.

    mass_g and edible_g: as served. left_g: edible grams left over; NULL: nobody has looked. consumed_g: what was eaten,
    edible less left, times the participant's share of the dish; signed, since clipping would bias means. The components
    are those of consumed_g. Components that the food table does not know are NULL, never 0; so is all that follows from
    an unknown amount, and every amount of a rejected item. density_g_per_ml: turned the volume into grams; NULL where a
    person set the grams. provisional: an after-meal pair may still come. doubt: the
    review queue's order, the greatest first. The columns of the day's and the page's filters are copied from the meal,
    which never changes them. food_version: of the row of item_food that holds. run_id: of the run that saw the region
    as it stands (no foreign key: its index would be for erasures alone, which delete the record first).
    """

    __tablename__ = "effective_record"
    personal = Personal(("meal_id",), "records")

    item_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("item.id"), primary_key=True)
    meal_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("meal.id"), index=True)
    study_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("study.id"))
    participant_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey("participant.id"))
    captured_at: Mapped[datetime]
    local_date: Mapped[date]
    status: Mapped[RecordStatus] = mapped_column(sa.String(16))
    origin: Mapped[ItemOrigin] = mapped_column(sa.String(16), default="pipeline")
    provisional: Mapped[bool] = mapped_column(default=False)
    reviewed: Mapped[bool] = mapped_column(default=False)  # a reviewer has had the last word
    food_id: Mapped[int | None] = mapped_column(sa.ForeignKey("food.id"))
    volume_ml: Mapped[float | None]
    volume_low_ml: Mapped[float | None]
    volume_high_ml: Mapped[float | None]
    density_g_per_ml: Mapped[float | None]
    density_source: Mapped[str | None] = mapped_column(sa.String(300))
    mass_g: Mapped[float | None]
    mass_low_g: Mapped[float | None]
    mass_high_g: Mapped[float | None]
    edible_g: Mapped[float | None]
    share: Mapped[float] = mapped_column(default=1.0)
    left_g: Mapped[float | None]
    consumed_g: Mapped[float | None]
    consumed_low_g: Mapped[float | None]
    consumed_high_g: Mapped[float | None]
    energy_kcal: Mapped[float | None]
    protein_g: Mapped[float | None]
    fat_g: Mapped[float | None]
    carbohydrate_g: Mapped[float | None]
    fibre_g: Mapped[float | None]
    sugar_g: Mapped[float | None]
    saturated_fat_g: Mapped[float | None]
    sodium_mg: Mapped[float | None]
    potassium_mg: Mapped[float | None]
    vitamin_c_mg: Mapped[float | None]
    flags: Mapped[list[Any]] = mapped_column(default=list)
    doubt: Mapped[float] = mapped_column(default=0.0)
    food_version: Mapped[int | None]
    run_id: Mapped[uuid.UUID | None]
    details: Mapped[RecordDetails] = mapped_column(JsonValue)
    change_seq: Mapped[int] = mapped_column(sa.BigInteger)

    __table_args__ = (
        one_of("status", RECORD_STATUSES),
        one_of("origin", ITEM_ORIGINS),
        sa.Index(None, "captured_at", "item_id"),
        sa.Index(None, "study_id", "captured_at", "item_id"),
        sa.Index(None, "study_id", "status", "captured_at", "item_id"),
        sa.Index(None, "food_id", "study_id", "status", "captured_at", "item_id"),
        sa.Index(None, "participant_id", "captured_at", "item_id"),
        sa.Index(None, "study_id", "change_seq"),
        sa.Index(None, "study_id", "reviewed", "status", "doubt", "item_id"),
        sa.Index("ix_effective_record_queue_of_food", "food_id", "study_id", "reviewed", "status", "doubt", "item_id"),
        sa.Index(
            "ix_effective_record_queue_of_provisional",
            *("study_id", "reviewed", "doubt", "item_id"),
            sqlite_where=sa.text("provisional IS 1"),
            postgresql_where=sa.text("provisional IS true"),
        ),
        sa.Index(None, "participant_id", "local_date"),
        # lists of meals by what holds of their items (exports/lists/meal_page_queries.py)
        sa.Index(
            "ix_effective_record_meals_of_food",
            *("food_id", "study_id", "captured_at", "meal_id", "local_date"),
            sqlite_where=sa.text("status <> 'rejected'"),
            postgresql_where=sa.text("status <> 'rejected'"),
        ),
        sa.Index(
            "ix_effective_record_meals_of_flags",
            *("study_id", "flags", "captured_at", "meal_id", "local_date"),
            sqlite_where=sa.text("status <> 'rejected' AND flags <> '[]'"),
            postgresql_where=sa.text("status <> 'rejected' AND flags <> '[]'"),
        ),
        sa.Index(
            "ix_effective_record_meals_to_review",
            *("study_id", "captured_at", "meal_id", "local_date"),
            sqlite_where=sa.text("status <> 'rejected' AND reviewed IS 0"),
            postgresql_where=sa.text("status <> 'rejected' AND reviewed IS false"),
        ),
    )

    @property
    def eaten_g(self) -> Estimate | None:
        """The edible grams that were eaten, signed; None where they are not known."""
        value, low, high = self.consumed_g, self.consumed_low_g, self.consumed_high_g
        return Estimate(value, low, high) if value is not None and low is not None and high is not None else None

    def nutrient_interval(self, column: str) -> tuple[float, float] | None:
        """The 90 % interval of one of HEADLINE_COLUMNS, which follows from that of the grams; None where unknown."""
        amount, grams = getattr(self, column), self.eaten_g
        return interval_in_proportion(amount, grams) if amount is not None and grams is not None else None

    def interval(self, name: str, unit: str) -> tuple[float, float] | None:
        """The 90 % interval of `{name}_{unit}`; None where it is not known."""
        low, high = getattr(self, f"{name}_low_{unit}"), getattr(self, f"{name}_high_{unit}")
        return (low, high) if low is not None and high is not None else None
