"""The index extended by each study's confirmed items: fitted once for a set of entries, and again when the set changes.

Whatever is confirmed, undone, rejected or erased counts from the next meal on: the entries are read each time. Only
vectors and the fit, which takes up to a second, are cached.
"""

import threading
import uuid
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import structlog

from app.candidates import queries as index_entries
from app.candidates.queries import Entry
from app.candidates.vcm_json import numbers_of
from app.db.session import Database
from app.identification.food_index import FoodIndex
from app.identification.identifier import MOST_EATEN, MOST_EXAMPLES, Example, Identifier
from app.identification.metric import Vectors
from app.meals.stored.models import Meal

log = structlog.get_logger()

MOST_STUDIES = 8  # in the cache, up to some 30 MB each

Key = tuple[uuid.UUID, uuid.UUID]  # item, run that saw it


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
            entries, vectors = self._read(meal, index, held.vectors if held is not None else {})
            if held is None or held.entries != entries:
                held = _Learned(
                    entries, vectors, Identifier(index, _examples(meal, index, entries, vectors))
                )
            self._learned[meal.study_id] = held
            while len(self._learned) > MOST_STUDIES:
                del self._learned[next(iter(self._learned))]
            return held.identifier

    def _read(
        self, meal: Meal, index: FoodIndex, cached: Mapping[Key, Vectors]
    ) -> tuple[tuple[Entry, ...], dict[Key, Vectors]]:
        with self._database.read() as session:
            entries = index_entries.entries_for(
                session,
                meal.study_id,
                index.vcm_version,
                without_meal=meal.id,
                most=MOST_EXAMPLES,
                most_recent=MOST_EATEN,
            )
            new = [entry for entry in entries if _key(entry) not in cached]
            read = index_entries.vectors_of(session, new, index.vcm_version)
        vectors = dict(cached) | {key: numbers_of(vector) for key, vector in read.items()}
        return tuple(entries), {
            key: vectors[key] for entry in entries if (key := _key(entry)) in vectors
        }


def _key(entry: Entry) -> Key:
    return entry.item_id, entry.run_id


def _examples(
    meal: Meal, index: FoodIndex, entries: tuple[Entry, ...], vectors: Mapping[Key, Vectors]
) -> list[Example]:
    """Return the entries with their vectors, without damaged ones, which would spoil all answers of the study."""
    shape = index.vectors.shape[1:]
    usable = {
        key
        for key, vector in vectors.items()
        if vector.shape == shape and np.isfinite(vector).all()
    }
    if len(usable) < len(entries):
        log.error("vectors_unusable", study_id=str(meal.study_id), count=len(entries) - len(usable))
    return [
        Example(
            name=f"{entry.item_id} {entry.run_id}",
            food_key=entry.food_key,
            vector=vectors[_key(entry)],
            volume_ml=entry.volume_ml,
            day_minute=entry.day_minute,
            is_own=entry.is_own,
            eater=str(entry.participant_id),
        )
        for entry in entries
        if _key(entry) in usable
    ]
