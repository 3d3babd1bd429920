"""Rank the foods of each item in a run's answer, by the index, the study's confirmed items and the eater's habits.

Runs in the worker, after the child has described the regions and before the answer is sealed, so
that saving the answer is reproducible. A failure never fails the meal: the items then have no
candidates. If the database is unavailable, the job is retried.

The index is extended by each study's confirmed items: fitted once for a set of entries, and again
when the set changes. Whatever is confirmed, undone, rejected or erased counts from the next meal
on: the entries are read each time. Only vectors and the fit, which takes up to a second, are
cached. A run whose marker was probably declared at a wrong size, judged by what stands around it,
is flagged.
"""

import math
import threading
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import structlog
from sqlalchemy.exc import SQLAlchemyError

from app.candidates import queries as index_entries
from app.candidates.food_groups import DECIMALS, candidate_answers, groups_of_foods
from app.candidates.queries import Entry
from app.candidates.vcm_json import numbers_of
from app.children.faults import is_passing
from app.db.session import Database
from app.identification.food_index import FoodIndex, shipped_index
from app.identification.habits import Eaten
from app.identification.identifier import (
    MOST_EATEN,
    MOST_EXAMPLES,
    Circumstances,
    Example,
    Identification,
    Identifier,
)
from app.identification.metric import Vectors
from app.identification.sizes import FoodSize, MeasuredFood, plausible_factor
from app.meals.stored.item_state import FOOD_IDENTIFIED, SCALE_DOUBTFUL
from app.meals.stored.meal_time import local_minute
from app.meals.stored.models import HintDetails, Meal
from app.meals.stored.run_answer import ItemAnswer, RunAnswer, VcmAnswer
from app.vision.looks.vcm import LENGTH, LENGTHS

log = structlog.get_logger()

MOST_SEALED = 20  # per item; fewer are saved (item_candidates.py), since a table may lack some
MOST_OF_EATER = 300  # a participant's items of some weeks


class IdentifyFoods:
    """The use case; one per worker process. index: read when it is first needed."""

    def __init__(self, database: Database, index: Callable[[], FoodIndex] = shipped_index) -> None:
        self._database = database
        self._index = index
        self._learned = LearnedIndex(database)

    def add_candidates(self, meal: Meal, answer: RunAnswer) -> None:
        """Set for each described item of the answer `candidates`, `none_probability` and `index_version`.

        A scale that the sizes of dishes and foods speak against is flagged.
        Raises SQLAlchemyError for a passing fault of the database (app/children/faults.py).
        """
        described = [(item, item.vcm) for item in answer.items if item.vcm is not None]
        if not described:
            return
        try:
            identifier = self._learned.identifier_for(meal, self._index())
            identified = self._identify(meal, described, identifier)
            for (item, _), identification in zip(described, identified, strict=True):
                if identification is not None:
                    item.candidates = candidate_answers(identification)[:MOST_SEALED]
                    item.none_probability = round(identification.none_probability, DECIMALS)
                    item.index_version = identification.index_version
            note_doubtful_scale(meal, answer, identifier)
        except (
            Exception
        ) as error:  # any bug: the volumes are computed, and a person can name the foods
            if isinstance(error, SQLAlchemyError) and is_passing(error):
                raise  # the database is unavailable, and a run's candidates are written only once
            log.exception("identify_failed", meal_id=str(meal.id))

    def _identify(
        self, meal: Meal, described: Sequence[tuple[ItemAnswer, VcmAnswer]], identifier: Identifier
    ) -> list[Identification | None]:
        """Identify each item; None if it was described by another version than the index's."""
        own = self._confirmed_foods(meal)
        day_minute = local_minute(meal.captured_at, meal.time_zone)
        identified: list[Identification | None] = []
        for item, vcm in described:
            if vcm.version != identifier.vcm_version:
                identified.append(None)
                continue
            circumstances = Circumstances(
                volume_ml=item.volume_ml,
                volume_relative_sd=math.hypot(*item.relative_sd.values()),
                day_minute=day_minute,
                own=own,
                eater=str(meal.participant_id),
            )
            identified.append(identifier.identify(numbers_of(vcm.vector), circumstances))
        return identified

    def _confirmed_foods(self, meal: Meal) -> list[Eaten]:
        """Return the foods that the participant has confirmed; one that only the server identified shows no habit."""
        with self._database.read() as session:
            rows = index_entries.eaten_before(
                session, meal.participant_id, without_meal=meal.id, most=MOST_OF_EATER
            )
        return [
            Eaten(row.food_key, local_minute(row.captured_at, row.time_zone))
            for row in rows
            if FOOD_IDENTIFIED not in row.flags
        ]


# a parameter of the run: what all lengths should be multiplied by
PLAUSIBLE_FACTOR = "plausible_scale_factor"


def note_doubtful_scale(meal: Meal, answer: RunAnswer, identifier: Identifier) -> None:
    """Flag the items, and note the factor, where the sizes of dishes and foods contradict the marker's."""
    if answer.parameters.get("scale_source") != "marker":
        return
    lengths_mm = dict(cast(dict[str, list[float]], answer.parameters.get("rim_radii_mm", {})))
    lengths_mm["camera"] = [cast(float, answer.parameters["camera_height_first_mm"])]
    hints = (
        meal.details["hints"] if not answer.regions else []
    )  # a run on redrawn regions has hints of its own
    foods = [
        MeasuredFood(
            item.volume_ml, math.hypot(*item.relative_sd.values()), _kinds(item, hints, identifier)
        )
        for item in answer.items
        if item.volume_ml
    ]
    factor = plausible_factor(lengths_mm, foods)
    if factor is not None:
        answer.parameters[PLAUSIBLE_FACTOR] = round(factor, 2)
        for item in answer.items:
            item.flags.append(SCALE_DOUBTFUL)


def _kinds(
    item: ItemAnswer, hints: Sequence[HintDetails], identifier: Identifier
) -> list[tuple[float, FoodSize]]:
    """The foods of known size that an item may be: the one that its hint names, else by its looks."""
    food = hints[item.hint].get("food") if hints and item.hint is not None else None
    if food is not None:
        size = identifier.size_of(food)
        return [(1.0, size)] if size is not None else []
    if item.vcm is None or item.vcm.version != identifier.vcm_version:
        return []
    return identifier.sizes_by_looks(numbers_of(item.vcm.vector))


MOST_STUDIES = 8  # in the cache, up to some 30 MB each

Key = tuple[uuid.UUID, uuid.UUID, str]  # item, run that saw it, version of its vector


@dataclass(frozen=True, slots=True)
class _Learned:
    """An identifier, the entries that it was fitted to, the newest last, and their vectors."""

    entries: tuple[Entry, ...]
    vectors: Mapping[Key, Vectors]
    identifier: Identifier


class LearnedIndex:
    """A cache of identifiers by study; one per worker process, shared by its threads."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._learned: dict[uuid.UUID, _Learned] = {}  # the most recently used at the end
        self._lock = threading.Lock()

    def identifier_for(self, meal: Meal, index: FoodIndex) -> Identifier:
        """Return the index with the confirmed items of the meal's study and of sharing studies, except this meal's."""
        with self._lock:
            held = self._learned.pop(meal.study_id, None)
            entries, vectors = self._read(meal, held.vectors if held is not None else {})
            if held is None or held.entries != entries:
                held = _Learned(
                    entries,
                    vectors,
                    Identifier(index, _examples(meal, entries, vectors), groups=groups_of_foods()),
                )
            self._learned[meal.study_id] = held
            while len(self._learned) > MOST_STUDIES:
                del self._learned[next(iter(self._learned))]
            return held.identifier

    def _read(
        self, meal: Meal, cached: Mapping[Key, Vectors]
    ) -> tuple[tuple[Entry, ...], dict[Key, Vectors]]:
        with self._database.read() as session:
            entries = index_entries.entries_for(
                session,
                meal.study_id,
                LENGTHS,
                without_meal=meal.id,
                most=MOST_EXAMPLES,
                most_recent=MOST_EATEN,
            )
            new = [entry for entry in entries if _key(entry) not in cached]
            read = index_entries.vectors_of(session, new)
        vectors = dict(cached) | {key: numbers_of(vector) for key, vector in read.items()}
        return tuple(entries), {
            key: vectors[key] for entry in entries if (key := _key(entry)) in vectors
        }


def _key(entry: Entry) -> Key:
    return entry.item_id, entry.run_id, entry.vcm_version


def _examples(
    meal: Meal, entries: tuple[Entry, ...], vectors: Mapping[Key, Vectors]
) -> list[Example]:
    """Return the entries with their vectors, without damaged ones, which would spoil all answers of the study.

    A vector of an earlier version lacks its last numbers: they are NaN (Metric.embed).
    """
    usable = {
        key: np.pad(vector, (0, LENGTH - len(vector)), constant_values=np.nan)
        for key, vector in vectors.items()
        if len(vector) == LENGTHS[key[2]] and np.isfinite(vector).all()
    }
    if len(usable) < len(entries):
        log.error("vectors_unusable", study_id=str(meal.study_id), count=len(entries) - len(usable))
    return [
        Example(
            name=f"{entry.item_id} {entry.run_id}",
            food_key=entry.food_key,
            vector=usable[_key(entry)],
            volume_ml=entry.volume_ml,
            day_minute=entry.day_minute,
            is_own=entry.is_own,
            eater=str(entry.participant_id),
        )
        for entry in entries
        if _key(entry) in usable
    ]
