"""Remeasurements and their table as HTTP and the command line give them."""

from collections import Counter
from collections.abc import Sequence

from app.records.remeasurements.choose_pairs import PlannedPair
from app.records.remeasurements.queries import ComparedRow
from app.records.remeasurements.remeasurements import RemeasurementView
from app.records.remeasurements.schemas import (
    ComparedItemOut,
    RemeasurementOut,
    RemeasurementPlanOut,
)

FIGURES = (
    *("old_volume_ml", "old_low_ml", "old_high_ml", "new_volume_ml", "new_low_ml", "new_high_ml"),
    *("old_mass_g", "new_mass_g", "is_changed"),
)


def render_remeasurement(view: RemeasurementView) -> RemeasurementOut:
    """Return a remeasurement with its progress."""
    row, progress = view.remeasurement, view.progress
    return RemeasurementOut(
        id=row.id,
        state=row.state,
        author=row.author,
        pipeline_version=row.pipeline_version,
        created_at=row.created_at,
        ended_at=row.ended_at,
        pairs=progress.pairs,
        waiting=progress.waiting,
        measured=progress.states.get("measured", 0),
        kept=progress.states.get("kept", 0),
        skipped=progress.states.get("skipped", 0),
        reasons=dict(progress.reasons),
        items=progress.items,
        items_changed=progress.items_changed,
    )


def render_row(row: ComparedRow) -> ComparedItemOut:
    """Return a row of the table."""
    return ComparedItemOut(
        participant=row.participant,
        meal_id=row.meal,
        captured_at=row.captured_at,
        pair=row.pair,
        state=row.state,
        reason=row.reason,
        item_id=row.item.item_id if row.item is not None else None,
        food=row.food,
        **{name: getattr(row.item, name, None) for name in FIGURES},
    )


def render_plan(pairs: Sequence[PlannedPair]) -> RemeasurementPlanOut:
    """Return the numbers of a plan."""
    skipped = Counter(pair.skip for pair in pairs if pair.skip is not None)
    return RemeasurementPlanOut(
        pairs=len(pairs),
        would_measure=len(pairs) - skipped.total(),
        would_skip=dict(sorted(skipped.items())),
    )
