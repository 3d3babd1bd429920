"""A meal's timeline, the newest entry first: photographs, runs, recomputations and events."""

import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any  # values of events are stored JSON

from markupsafe import Markup

from app.dashboard.templates import amount, percent, words
from app.meals.stored.job_models import Job
from app.meals.stored.outline_json import rings_of
from app.meals.stored.record_models import Run
from app.photos.slots import PAIR_SLOTS, VOICE_NOTE
from app.records.review.meal_history import HistoryRow, MealStory

SERVER = "server"
TITLES: Mapping[str, str] = {
    "confirm": "Confirmed",
    "reject": "Rejected",
    "set_food": "Food",
    "set_volume": "Volume",
    "set_mass": "Mass",
    "set_share": "Share",
    "redraw": "Outline redrawn",
    "reshape": "Form by hand",
    "declare": "Declared",
    "add": "Added",
    "split": "Split",
    "merge": "Merged",
    "set_leftover": "What was left",
    "nothing_left": "Nothing left",
    "confirm_meal": "Meal confirmed",
    "comment": "Comment",
    "question": "Question to the participant",
    "answer": "Answer of the participant",
    "undo": "Taken back",
}
PURPOSES: Mapping[str, str] = {
    "meal": "Estimate of the meal",
    "after": "Estimate of what was left",
    "remeasure": "Measurement of a drawn region",
    "rerun": "Repeated estimate of the meal",
    "rerun_after": "Repeated estimate of what was left",
}
PHOTOGRAPHS: Mapping[str, str] = {
    "left": "Left photograph",
    "right": "Right photograph",
    **{f"view{number}": f"Photograph {number}" for number in range(3, 9)},
    **{
        f"{view}_{kind}": f"{kind.capitalize()} map of the {view} photograph"
        for view in PAIR_SLOTS
        for kind in ("depth", "confidence")
    },
    "after_left": "Left photograph after the meal",
    "after_right": "Right photograph after the meal",
    VOICE_NOTE: "Voice note",
}
TEXT_ONLY = frozenset({"comment", "question", "answer"})
LABELS: Mapping[str, str] = {
    "status": "status",
    "food": "food",
    "foods": "foods",
    "lies_as": "lies as",
    "volume_ml": "volume",
    "mass_g": "mass",
    "of": "of",
    "portion": "measure",
    "count": "how many",
    "relative_sd": "give or take",
    "share": "share",
    "polygon": "outline",
    "form": "form",
    "region": "place",
    "parts": "parts",
    "probe": "question",
    "answer": "answer",
    "class": "is",
    "kind": "what",
}


@dataclass(frozen=True, slots=True)
class Changed:
    """A value before and after; None: there was none."""

    label: str
    old: Markup | None
    new: Markup | None


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry of the timeline. layer: automatic, participant or reviewer. failure: a code.

    event_id, sequence: of an event, else None.
    """

    at: datetime
    author: str
    layer: str
    title: str
    item: uuid.UUID | None = None
    changes: tuple[Changed, ...] = ()
    text: str | None = None
    note: str = ""
    failure: str | None = None
    event_id: uuid.UUID | None = None
    sequence: int | None = None
    is_undone: bool = False
    may_be_undone: bool = False


def timeline(story: MealStory) -> list[Entry]:
    """Return all entries, the newest first."""
    names = food_names(story)
    entries = [
        *_photographs(story),
        *_work(story),
        *(event_entry(row, names) for row in story.events),
    ]
    return sorted(entries, key=lambda entry: (entry.at, entry.sequence or 0), reverse=True)


def food_names(story: MealStory) -> dict[str, str]:
    """Return key -> name of the foods and candidates of the meal's items; events hold keys."""
    names: dict[str, str] = {}
    for item in story.view.items:
        names |= {
            candidate.food.key: candidate.food.name for candidate in item.candidates.candidates
        }
        if item.food is not None:
            names[item.food.key] = item.food.name
    return names


def event_entry(row: HistoryRow, names: Mapping[str, str]) -> Entry:
    """Return an event as an entry. names: food key -> name."""
    event = row.event
    old, new = _flat(event.old), _flat(event.new)
    if event.kind in TEXT_ONLY:
        old = new = {}
    if event.kind == "undo":
        old, new = {}, {"kind": TITLES.get(str(event.old.get("kind")), "")}
    return Entry(
        at=event.created_at,
        author=row.author,
        layer=event.layer,
        title=TITLES.get(event.kind, event.kind),
        item=event.item_id,
        changes=tuple(
            Changed(LABELS[key], _shown(key, old.get(key), names), _shown(key, new.get(key), names))
            for key in LABELS
            if key in new or (key in old and event.kind != "split")
        ),
        text=event.new.get("text"),
        event_id=event.id,
        sequence=event.sequence,
        is_undone=row.is_undone,
        may_be_undone=event.kind != "undo" and not row.is_undone,
    )


def _flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return an event's values with those of its amount at the top level, without None."""
    flat = dict(values)
    if isinstance(flat.get("amount"), Mapping):
        flat |= flat.pop("amount")
    return {key: value for key, value in flat.items() if value is not None}


def _shown(key: str, value: Any, names: Mapping[str, str]) -> Markup | None:
    if value is None:
        return None
    if key in ("volume_ml", "mass_g"):
        return amount(float(value), "ml" if key == "volume_ml" else "g")
    if key in ("share", "relative_sd"):
        return percent(float(value))
    if key == "food":
        return Markup("{}").format(names.get(str(value), value))
    if key == "foods":
        return Markup("{}").format(
            ", ".join(names.get(str(food), str(food)) for food in value if food is not None)
        )
    if key in ("polygon", "parts"):
        return Markup("{} {}").format(
            _count(key, value), "corners" if key == "polygon" else "parts"
        )
    if key == "form":
        sides = " × ".join(f"{value[name]:.0f}" for name in ("length_mm", "width_mm", "height_mm"))
        return Markup("{}, {} mm").format(value["section"], sides)
    if key == "region":
        return Markup("{}").format(
            ", ".join(str(name) for name, place in value.items() if place is not None)
        )
    if key in ("status", "of", "class", "answer", "lies_as"):
        return words(str(value))
    return Markup("{}").format(value)


def _count(key: str, value: Any) -> int:
    """Count the corners of all rings of an outline, or the parts."""
    return sum(len(ring) for ring in rings_of(value)) if key == "polygon" else len(value)


def _photographs(story: MealStory) -> Iterator[Entry]:
    for image in story.view.images:
        yield Entry(
            image.received_at,
            story.view.participant_code,
            "participant",
            f"{PHOTOGRAPHS[image.slot]} received",
        )
        if image.erased_at is not None:
            yield Entry(image.erased_at, SERVER, "automatic", f"{PHOTOGRAPHS[image.slot]} erased")


def _work(story: MealStory) -> Iterator[Entry]:
    ran = {run.id for run in story.runs}
    for run in story.runs:
        yield _run(run)
    for job in story.jobs:
        if job.id not in ran:
            yield _job(job)
    for recompute in story.recomputes:
        yield Entry(
            recompute.started_at,
            recompute.author,
            "automatic",
            "Nutrients recomputed",
            text=recompute.reason,
            note=", ".join(str(release) for release in recompute.food_releases),
        )


def _run(run: Run) -> Entry:
    return Entry(
        run.created_at,
        SERVER,
        "automatic",
        PURPOSES.get(run.purpose, run.purpose),
        note=f"method {run.method}, version {run.pipeline_version}, {run.seconds:.1f} s",
        failure=run.failure_code,
    )


def _job(job: Job) -> Entry:
    """Return an entry for a job without a run: it waits, is running, or failed."""
    at = job.finished_at or job.started_at or job.enqueued_at
    note = {
        "queued": "waits for a worker",
        "processing": "running",
        "failed": "ended without a result",
    }
    return Entry(
        at,
        SERVER,
        "automatic",
        PURPOSES.get(job.purpose, job.purpose),
        note=note.get(job.state, job.state),
    )
