"""The index with what each study has learned: fitted once for a set of entries, and again when that set is another.

Whatever was confirmed, taken back, rejected or erased since counts at the next meal: the entries are read each time,
and only the vectors that are new, and the fit, which takes a second at most, are saved by remembering.
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
from app.meals.models import Meal

log = structlog.get_logger()

MOST_STUDIES = 8  # that are remembered, some 30 MB each when full

Key = tuple[uuid.UUID, uuid.UUID]  # item, and the run that saw it


@dataclass(frozen=True, slots=True)
class _Learned:
    """An identifier, the entries that it was made of, the newest last, and their vectors."""

    entries: tuple[Entry, ...]
    vectors: Mapping[Key, Vectors]
    identifier: Identifier


class LearnedIndex:
    """Identifiers by study; one a worker process, for all of its threads."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._learned: dict[uuid.UUID, _Learned] = {}  # the one that was used last at the end
        self._lock = threading.Lock()

    def identifier_for(self, meal: Meal, index: FoodIndex) -> Identifier:
        """The index with the confirmed items of the meal's study and of those that share theirs; none of this meal."""
        with self._lock:
            held = self._learned.pop(meal.study_id, None)
            entries, vectors = self._read(meal, index, held.vectors if held is not None else {})
            if held is None or held.entries != entries:
                held = _Learned(entries, vectors, Identifier(index, _examples(meal, index, entries, vectors)))
            self._learned[meal.study_id] = held
            while len(self._learned) > MOST_STUDIES:
                del self._learned[next(iter(self._learned))]
            return held.identifier

    def _read(
        self, meal: Meal, index: FoodIndex, known: Mapping[Key, Vectors]
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
            new = [entry for entry in entries if _key(entry) not in known]
            read = index_entries.vectors_of(session, new, index.vcm_version)
        vectors = dict(known) | {key: numbers_of(vector) for key, vector in read.items()}
        return tuple(entries), {key: vectors[key] for entry in entries if (key := _key(entry)) in vectors}


def _key(entry: Entry) -> Key:
    return entry.item_id, entry.run_id


def _examples(
    meal: Meal, index: FoodIndex, entries: tuple[Entry, ...], vectors: Mapping[Key, Vectors]
) -> list[Example]:
    """The entries with their vectors. One that is spoilt is left out: it would spoil all answers of the study."""
    shape = index.vectors.shape[1:]
    usable = {key for key, vector in vectors.items() if vector.shape == shape and np.isfinite(vector).all()}
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
