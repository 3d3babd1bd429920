"""Runs, items, measures, leftovers, candidates and foods, all append-only; effective records, a projection of them."""

import uuid
from datetime import date, datetime
from typing import Literal, TypedDict, get_args

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base, BlobColumns, JsonValue, Personal, index_where, one_of
from app.db.columns import (
    BigInt,
    FoodRef,
    IntKey,
    ItemRef,
    JobRef,
    LongStr,
    MealEventRef,
    MealRef,
    ParticipantRef,
    RunRef,
    Str8,
    Str16,
    Str32,
    Str64,
    Str200,
    Str300,
    StudyRef,
    UuidKey,
)
from app.meals.stored.event_models import LAYERS
from app.meals.stored.job_models import JOB_PURPOSES, JobPurpose
from app.meals.stored.outline_json import Ring
from app.meals.stored.run_answer import Json
from app.nutrition.components import HEADLINE_COLUMNS, HEADLINES
from app.nutrition.doubt import Estimate
from app.nutrition.nutrients import interval_in_proportion

NEEDS_LOOK = "status <> 'rejected' AND reviewed IS {no} AND (origin <> 'declared' OR status = 'needs_review')"
RecordStatus = Literal["proposed", "needs_review", "confirmed", "corrected", "rejected"]
RECORD_STATUSES: tuple[RecordStatus, ...] = get_args(RecordStatus)
ItemOrigin = Literal["pipeline", "after", "declared", "added", "split", "merged"]
ITEM_ORIGINS: tuple[ItemOrigin, ...] = get_args(ItemOrigin)
LeftoverClass = Literal["food_left", "refuse", "unmatched"]
# the phone's hint, the food index, an operator's network
CandidateSource = Literal["hint", "index", "model"]
LEFTOVER_CLASSES: tuple[LeftoverClass, ...] = get_args(LeftoverClass)


# `class` is a keyword
HintedLeftover = TypedDict("HintedLeftover", {"item": str, "class": str}, total=False)


class TraitDetails(TypedDict, total=False):
    """What leftovers are matched by.

    centre_mm, radius_mm: in the table frame
    told: by the phone's hint
    """

    centre_mm: list[float] | None
    radius_mm: float | None
    lab: list[float] | None
    told: HintedLeftover


class ColourDetails(TypedDict):
    """A photograph's colour correction by the marker.

    matrix: as in vision/model.py, ColourCorrection.
    """

    kind: str
    matrix: list[list[float]]
    delta_e_mean: float | None
    delta_e_worst: float | None
    flags: list[str]


class MassDoubt(TypedDict):
    """Edible grams as one term of a meal's total, with their relative standard deviation by part."""

    edible_g: float
    pair: float
    density: float
    item: float


class RecordDetails(TypedDict):
    """What readers of the meal need beside a record's columns.

    rings: the item's current region; None: the item's own
    served, left: the terms of the meal's totals; left: one per leftover
    open_probes: unanswered probes of its food
    """

    rings: list[Ring] | None
    served: MassDoubt | None
    left: list[MassDoubt]
    open_probes: list[str]


class Run(Base):
    """One execution of the pipeline on a meal, never updated.

    id: the job's; purpose: the job's, with one exception

    Only a run with the purpose "meal" creates the meal's items; the newest one counts. A run of a
    remeasurement becomes "meal" or "after" if the meal's records rest on it; otherwise it keeps the
    purpose "rerun" or "rerun_after".
    """

    __tablename__ = "run"
    personal = Personal(("meal_id",), "runs", order_by="created_at")
    blob = BlobColumns("result_key")

    id: Mapped[JobRef] = mapped_column(primary_key=True)
    meal_id: Mapped[MealRef] = mapped_column(index=True)
    purpose: Mapped[JobPurpose] = mapped_column(sa.String(16), default="meal")
    method: Mapped[Str32]
    pipeline_version: Mapped[Str32]
    marker: Mapped[Str64 | None]  # NULL: a rig, poses or a depth map
    camera: Mapped[Json | None] = mapped_column(JsonValue)
    parameters: Mapped[Json] = mapped_column(JsonValue)
    # by side, "left" and "right"
    colour: Mapped[dict[str, ColourDetails] | None] = mapped_column(JsonValue)
    stages: Mapped[dict[str, float]]  # seconds
    seconds: Mapped[float]
    # the tables in force, "name version", in the order of their precedence
    food_releases: Mapped[list[str]]
    failure_code: Mapped[Str64 | None]
    failure_message: Mapped[LongStr | None]
    # the complete answer, in the blob store
    result_key: Mapped[Str300] = mapped_column(unique=True)
    remeasurement_id: Mapped[uuid.UUID | None] = mapped_column(
        sa.ForeignKey("remeasurement.id"), index=True
    )
    created_at: Mapped[datetime]

    __table_args__ = (one_of("purpose", JOB_PURPOSES),)


class RunArtefact(Base):
    """A picture or point cloud of one of a run's steps, in the blob store."""

    __tablename__ = "run_artefact"
    personal = Personal(("run_id",), "derived_pictures")
    blob = BlobColumns()

    run_id: Mapped[RunRef] = mapped_column(primary_key=True)
    name: Mapped[Str64] = mapped_column(primary_key=True)
    media_type: Mapped[Str64]
    bytes: Mapped[BigInt]
    sha256: Mapped[Str64]
    blob_key: Mapped[Str300] = mapped_column(unique=True)


class Item(Base):
    """One food of a meal, found by a run or entered by a person: its outline and its volume with the uncertainty.

    origin: "pipeline", found in the meal's pair; "after", found in the after-meal pair (food left,
        or refuse); "declared", entered without photographs; "added", seen by a person but not by
        the pipeline; "split" and "merged", made from other items by event_id. Without a volume
        (flag "not_measurable", or a person entered grams) the interval is NULL and relative_sd
        empty.
    parent_id: the item that it was split from, or whose probe a declared item answers
    """

    __tablename__ = "item"
    personal = Personal(("meal_id",), "items", order_by="position")

    id: Mapped[UuidKey]
    meal_id: Mapped[MealRef] = mapped_column(index=True)
    run_id: Mapped[RunRef | None]
    origin: Mapped[ItemOrigin] = mapped_column(sa.String(16), default="pipeline")
    parent_id: Mapped[ItemRef | None] = mapped_column(index=True)
    event_id: Mapped[MealEventRef | None] = mapped_column(index=True)
    position: Mapped[int]
    rings: Mapped[list[Ring]] = mapped_column(JsonValue)
    volume_ml: Mapped[float | None]
    volume_low_ml: Mapped[float | None]
    volume_high_ml: Mapped[float | None]
    relative_sd: Mapped[dict[str, float]]
    flags: Mapped[list[str]]
    traits: Mapped[TraitDetails] = mapped_column(JsonValue, default=dict)

    __table_args__ = (
        sa.UniqueConstraint("run_id", "position"),
        one_of("origin", ITEM_ORIGINS),
        sa.CheckConstraint(
            "(run_id IS NULL) = (origin NOT IN ('pipeline', 'after'))", name="run_of_what_it_found"
        ),
        sa.CheckConstraint(
            "(volume_ml IS NULL) = (volume_low_ml IS NULL) AND (volume_ml IS NULL) = (volume_high_ml IS NULL)",
            name="volume_with_interval",
        ),
    )


class ItemMeasure(Base):
    """An item measured again: in a region that a person drew (event_id), or by a remeasurement (event_id NULL).

    Append-only. That of the newest effective event counts, else that of the newest remeasurement,
    else the item's own. If the run could not measure it, the volume is NULL and flags say why;
    "replaced": the new run has other items.
    """

    __tablename__ = "item_measure"
    personal = Personal(("item_id",), "measured_again")

    item_id: Mapped[ItemRef] = mapped_column(primary_key=True)
    run_id: Mapped[RunRef] = mapped_column(primary_key=True, index=True)
    event_id: Mapped[MealEventRef | None] = mapped_column(index=True)
    rings: Mapped[list[Ring]] = mapped_column(JsonValue)
    volume_ml: Mapped[float | None]
    volume_low_ml: Mapped[float | None]
    volume_high_ml: Mapped[float | None]
    relative_sd: Mapped[dict[str, float]]
    flags: Mapped[list[str]]

    __table_args__ = (sa.UniqueConstraint("item_id", "event_id"),)


class Leftover(Base):
    """The class of an item of the after-meal pair: food left of an item, refuse of it, or unmatched.

    Append-only: the highest version of the highest layer counts. event_id: the event that set it;
    NULL: the server matched it.
    """

    __tablename__ = "leftover"
    personal = Personal(("after_item_id", "item_id"), "leftovers")

    after_item_id: Mapped[ItemRef] = mapped_column(primary_key=True)
    version: Mapped[IntKey]
    item_id: Mapped[ItemRef | None] = mapped_column(index=True)
    leftover_class: Mapped[LeftoverClass] = mapped_column(sa.String(16))
    layer: Mapped[Str16] = mapped_column(default="automatic")
    event_id: Mapped[MealEventRef | None] = mapped_column(index=True)
    flags: Mapped[list[str]]
    created_at: Mapped[datetime]

    __table_args__ = (
        one_of("leftover_class", LEFTOVER_CLASSES),
        one_of("layer", LAYERS),
        sa.CheckConstraint(
            "(item_id IS NULL) = (leftover_class = 'unmatched')", name="matched_to_an_item"
        ),
    )


class ItemCandidate(Base):
    """A food that an item may be, by the phone's "hint", the "index" or a "model", best first within a source and run.

    Append-only: if a later run identifies the item again, its candidates get the next positions and
    replace the earlier ones. run_id: NULL for the run that found the item. probability: NULL for a
    hint. reasons: what speaks for or against it beside its looks.
    """

    __tablename__ = "item_candidate"
    personal = Personal(("item_id",), "candidates")

    item_id: Mapped[ItemRef] = mapped_column(primary_key=True)
    position: Mapped[IntKey]
    food_id: Mapped[FoodRef]
    probability: Mapped[float | None]
    source: Mapped[CandidateSource] = mapped_column(sa.String(16))
    run_id: Mapped[RunRef | None] = mapped_column(index=True)
    reasons: Mapped[list[str] | None]


class ItemFood(Base):
    """The food assigned to an item, with the density that turns its volume into grams; append-only.

    The highest version of the highest layer counts, unless its event was undone. Density and edible
    share are copied when they are chosen, so that a record can always be rebuilt. If the food table
    has no density, its columns are NULL. recompute_id: the recomputation that wrote it.
    """

    __tablename__ = "item_food"
    personal = Personal(("item_id",), "taken_for", order_by="version")

    item_id: Mapped[ItemRef] = mapped_column(primary_key=True)
    version: Mapped[IntKey]
    food_id: Mapped[FoodRef]
    lies_as: Mapped[Str16 | None]  # its form on the plate; NULL: the food's usual form
    density_g_per_ml: Mapped[float | None]
    density_sd_g_per_ml: Mapped[float | None]
    density_state: Mapped[Str32 | None]
    density_kind: Mapped[Str8 | None]
    density_basis: Mapped[Str32 | None]
    density_source: Mapped[Str300 | None]
    density_weighs: Mapped[Str8 | None]
    edible_share: Mapped[float]
    layer: Mapped[Str16] = mapped_column(default="automatic")
    event_id: Mapped[MealEventRef | None] = mapped_column(index=True)
    recompute_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey("recompute.id"))
    created_at: Mapped[datetime]

    __table_args__ = (one_of("layer", LAYERS),)


class Recompute(Base):
    """One `tada records recompute --nutrients`: who ran it, when and why."""

    __tablename__ = "recompute"

    id: Mapped[UuidKey]
    author: Mapped[Str200]
    reason: Mapped[LongStr]
    food_releases: Mapped[list[str]]
    started_at: Mapped[datetime]


class HeadlineAmounts:
    """A column for each of HEADLINES: its amount in consumed_g; NULL if unknown."""

    energy_kcal: Mapped[float | None]


for _headline in HEADLINES:
    setattr(HeadlineAmounts, _headline.column, mapped_column(sa.Double))


class EffectiveRecord(HeadlineAmounts, Base):
    """The current state of an item: food, grams, headline components.

    Can be rebuilt from runs and events.

    mass_g, edible_g: as served
    left_g: edible grams left over; NULL: nobody has checked for leftovers
    consumed_g: edible less left, times the participant's share of the dish; signed, since clipping
        would bias means. The components are those of consumed_g. A component that the food table
        lacks is NULL, never 0; so is everything that follows from an unknown amount, and every
        amount of a rejected item.
    density_g_per_ml: the density used; NULL if a person set the grams
    provisional: an after-meal pair may still come
    doubt: the review queue's order, greatest first. Columns that filters use are copied from the
        meal, where they never change.
    food_version: of the row of item_food that counts
    run_id: of the run that saw the current region (no foreign key: only erasures would use its
        index, and they delete the record first)
    """

    __tablename__ = "effective_record"
    personal = Personal(("meal_id",), "records")

    item_id: Mapped[ItemRef] = mapped_column(primary_key=True)
    meal_id: Mapped[MealRef] = mapped_column(index=True)
    study_id: Mapped[StudyRef]
    participant_id: Mapped[ParticipantRef]
    captured_at: Mapped[datetime]
    local_date: Mapped[date]
    status: Mapped[RecordStatus] = mapped_column(sa.String(16))
    origin: Mapped[ItemOrigin] = mapped_column(sa.String(16), default="pipeline")
    provisional: Mapped[bool] = mapped_column(default=False)
    # a reviewer decided last, and the amount is known
    reviewed: Mapped[bool] = mapped_column(default=False)
    food_id: Mapped[FoodRef | None]
    volume_ml: Mapped[float | None]
    volume_low_ml: Mapped[float | None]
    volume_high_ml: Mapped[float | None]
    density_g_per_ml: Mapped[float | None]
    density_source: Mapped[Str300 | None]
    mass_g: Mapped[float | None]
    mass_low_g: Mapped[float | None]
    mass_high_g: Mapped[float | None]
    edible_g: Mapped[float | None]
    share: Mapped[float] = mapped_column(default=1.0)
    left_g: Mapped[float | None]
    consumed_g: Mapped[float | None]
    consumed_low_g: Mapped[float | None]
    consumed_high_g: Mapped[float | None]
    flags: Mapped[list[str]] = mapped_column(default=list)
    doubt: Mapped[float] = mapped_column(default=0.0)
    food_version: Mapped[int | None]
    run_id: Mapped[uuid.UUID | None]
    details: Mapped[RecordDetails] = mapped_column(JsonValue)
    change_seq: Mapped[BigInt]

    __table_args__ = (
        one_of("status", RECORD_STATUSES),
        one_of("origin", ITEM_ORIGINS),
        # pages of records (records/page_queries.py); with the local day, so that filters of days read no row
        sa.Index("ix_effective_record_page", "captured_at", "item_id", "local_date"),
        sa.Index(
            "ix_effective_record_page_of_study", "study_id", "captured_at", "item_id", "local_date"
        ),
        sa.Index(
            "ix_effective_record_page_of_status",
            "study_id",
            "status",
            "captured_at",
            "item_id",
            "local_date",
        ),
        sa.Index(
            "ix_effective_record_page_of_food",
            *("food_id", "study_id", "status", "captured_at", "item_id", "local_date"),
        ),
        # the same without the day: for code before these, dropped a release after (docs/development.md, "Migrations")
        sa.Index(None, "captured_at", "item_id"),
        sa.Index(None, "study_id", "captured_at", "item_id"),
        sa.Index(None, "study_id", "status", "captured_at", "item_id"),
        sa.Index(None, "food_id", "study_id", "status", "captured_at", "item_id"),
        sa.Index(None, "participant_id", "captured_at", "item_id"),
        sa.Index(None, "study_id", "change_seq"),
        sa.Index(None, "study_id", "reviewed", "status", "doubt", "item_id"),
        sa.Index(
            "ix_effective_record_queue_of_food",
            "food_id",
            "study_id",
            "reviewed",
            "status",
            "doubt",
            "item_id",
        ),
        index_where(
            "ix_effective_record_queue_of_provisional",
            *("study_id", "reviewed", "doubt", "item_id"),
            where="provisional IS {yes}",
        ),
        sa.Index(  # all that a day sums (diary/day_definition.py)
            "ix_effective_record_days",
            *(
                "participant_id",
                "local_date",
                "status",
                "provisional",
                "consumed_g",
                *HEADLINE_COLUMNS,
            ),
        ),
        # lists of meals filtered by their items (exports/lists/meal_page_queries.py)
        index_where(
            "ix_effective_record_meals_of_food",
            *("food_id", "study_id", "captured_at", "meal_id", "local_date"),
            where="status <> 'rejected'",
        ),
        index_where(
            "ix_effective_record_meals_of_flags",
            *("study_id", "flags", "captured_at", "meal_id", "local_date"),
            where="status <> 'rejected' AND flags <> '[]'",
        ),
        index_where(
            "ix_effective_record_meals_to_review",
            *("study_id", "captured_at", "meal_id", "local_date"),
            where="status <> 'rejected' AND reviewed IS {no}",
        ),
        # those that need a look (records/page_queries.py), for the review queue and lists of
        # meals; the index before, and that of all reviewed, are for code before these, dropped a
        # release after
        index_where(
            "ix_effective_record_look_queue",
            *("study_id", "reviewed", "status", "doubt", "item_id"),
            where=NEEDS_LOOK,
        ),
        index_where(
            "ix_effective_record_look_meals",
            *("study_id", "captured_at", "meal_id", "local_date"),
            where=NEEDS_LOOK,
        ),
    )

    @property
    def eaten_g(self) -> Estimate | None:
        """The edible grams that were eaten, signed; None if unknown."""
        value, low, high = self.consumed_g, self.consumed_low_g, self.consumed_high_g
        return (
            Estimate(value, low, high)
            if value is not None and low is not None and high is not None
            else None
        )

    def nutrient_intervals(self) -> dict[str, tuple[float, float] | None]:
        """Return the 90 % interval of each of HEADLINES, in proportion to that of the grams; None if unknown."""
        grams = self.eaten_g
        amounts = {column: getattr(self, column) for column in HEADLINE_COLUMNS}
        return {
            column: interval_in_proportion(amount, grams)
            if amount is not None and grams is not None
            else None
            for column, amount in amounts.items()
        }

    def interval(self, name: str, unit: str) -> tuple[float, float] | None:
        """Return the 90 % interval of the column `{name}_{unit}`; None if unknown."""
        low, high = getattr(self, f"{name}_low_{unit}"), getattr(self, f"{name}_high_{unit}")
        return (low, high) if low is not None and high is not None else None
