"""A meal's story as one list, the newest first: photographs, runs, recomputations and what people said."""

import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from markupsafe import Markup

from app.dashboard.templates import amount, percent, words
from app.meals.job_models import Job
from app.meals.outline_json import rings_of
from app.meals.record_models import Run
from app.records.meal_story import MealStory
from app.records.review.meal_history import HistoryRow

SERVER = "server"
TITLES: Mapping[str, str] = {
    "confirm": "Confirmed",
    "reject": "Rejected",
    "set_food": "Food",
    "set_volume": "Volume",
    "set_mass": "Mass",
    "set_share": "Share",
    "redraw": "Outline drawn anew",
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
}
SLOTS: Mapping[str, str] = {
    "left": "Left photograph",
    "right": "Right photograph",
    "after_left": "Left photograph after the meal",
    "after_right": "Right photograph after the meal",
}
WORDS_ONLY = frozenset({"comment", "question", "answer"})
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
    "region": "place",
    "parts": "parts",
    "probe": "question",
    "answer": "answer",
    "class": "is",
    "kind": "what",
}


@dataclass(frozen=True, slots=True)
class Changed:
    """One value before and after; None: there was none."""

    label: str
    old: Markup | None
    new: Markup | None


@dataclass(frozen=True, slots=True)
class Entry:
    """One thing that happened. layer: automatic, participant or reviewer. event_id: of a word that somebody said.

    sequence: the word's number in the meal, None: not a word. failure: a code.
    """

    at: datetime
    who: str
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
    """All of it, the newest first."""
    names = food_names(story)
    found = [*_photographs(story), *_work(story), *(word(row, names) for row in story.events)]
    return sorted(found, key=lambda entry: (entry.at, entry.sequence or 0), reverse=True)


def food_names(story: MealStory) -> dict[str, str]:
    """Names of the foods that the meal's items are, or may be, by key: events hold keys."""
    names: dict[str, str] = {}
    for item in story.view.items:
        names |= {each.food.key: each.food.name for each in item.candidates.candidates}
        if item.food is not None:
            names[item.food.key] = item.food.name
    return names


def word(row: HistoryRow, names: Mapping[str, str]) -> Entry:
    """An event as an entry."""
    event = row.event
    old, new = _plain(event.old), _plain(event.new)
    if event.kind in WORDS_ONLY:
        old = new = {}
    if event.kind == "undo":
        old, new = {}, {"kind": TITLES.get(str(event.old.get("kind")), "")}
    return Entry(
        at=event.created_at,
        who=row.author,
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


def _plain(told: Mapping[str, Any]) -> dict[str, Any]:
    """An event's values, amounts among them brought to the top; nothing that says nothing."""
    flat = dict(told)
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
        return Markup("{}").format(", ".join(names.get(str(one), str(one)) for one in value if one is not None))
    if key in ("polygon", "parts"):
        return Markup("{} {}").format(_count(key, value), "corners" if key == "polygon" else "parts")
    if key == "region":
        return Markup("{}").format(", ".join(str(name) for name, place in value.items() if place is not None))
    if key in ("status", "of", "class", "answer", "lies_as"):
        return words(str(value))
    return Markup("{}").format(value)


def _count(key: str, value: Any) -> int:
    """Corners of an outline, of all its rings where it has several; or parts."""
    return sum(len(ring) for ring in rings_of(value)) if key == "polygon" else len(value)


def _photographs(story: MealStory) -> Iterator[Entry]:
    for image in story.view.images:
        yield Entry(image.received_at, story.view.participant_code, "participant", f"{SLOTS[image.slot]} received")
        if image.erased_at is not None:
            yield Entry(image.erased_at, SERVER, "automatic", f"{SLOTS[image.slot]} erased")


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
            "Nutrients computed anew",
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
    """Work that left no run: it waits, is under way, or was given up."""
    at = job.finished_at or job.started_at or job.enqueued_at
    note = {"queued": "waits for a worker", "processing": "under way", "failed": "ended without an answer"}
    return Entry(at, SERVER, "automatic", PURPOSES.get(job.purpose, job.purpose), note=note.get(job.state, job.state))
