"""Which food each item of a run's answer may be, by the index, what the study has confirmed, and who eats what when.

Runs in the worker, after the child has described the regions and before the answer is sealed, so that saving it is the
same whenever it is done. It never fails a meal: where it cannot be done, the items have no candidates.
"""

import math
import threading
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import structlog

from app.db.models import Meal
from app.db.queries import index_entries
from app.db.queries.index_entries import Entry
from app.db.session import Database
from app.identification.food_index import FoodIndex, shipped_index
from app.identification.habits import Eaten
from app.identification.identifier import MOST_EXAMPLES, Circumstances, Example, Identifier
from app.identification.metric import Vectors
from app.services.item_state import FOOD_IDENTIFIED
from app.services.meal_time import local_minute
from app.services.vcm_json import ItemVcm, numbers_of, vcm_of

log = structlog.get_logger()

MOST_SEALED = 20  # of an item; fewer are kept (save_candidates.py), since a table may lack some
MOST_EATEN = 300  # of a participant's items: some weeks
MOST_STUDIES = 8  # whose identifiers a worker keeps, some 30 MB each when full
DECIMALS = 6


@dataclass(frozen=True, slots=True)
class _Learned:
    """An identifier, the entries that it was made of, the newest last, and their vectors by (item, run)."""

    entries: tuple[Entry, ...]
    vectors: Mapping[tuple[uuid.UUID, uuid.UUID], Vectors]
    identifier: Identifier


class IdentifyFoods:
    """The use case; one a worker process. index: read when it is first needed."""

    def __init__(self, database: Database, index: Callable[[], FoodIndex] = shipped_index) -> None:
        self._database = database
        self._index = index
        self._learned: dict[uuid.UUID, _Learned] = {}  # by study, the one that was used last at the end
        self._lock = threading.Lock()

    def add_candidates(self, meal: Meal, answer: dict[str, Any]) -> None:
        """Give each described item of the answer `candidates`, `none_probability` and `index_version`."""
        described = [(found, vcm) for found in answer["items"] if (vcm := vcm_of(found)) is not None]
        if not described:
            return
        try:
            told = self._identify(meal, described)
        except Exception:  # whatever it is: the volumes are there, and a person can name the foods
            log.exception("identify_failed", meal_id=str(meal.id))
            return
        for (found, _), fields in zip(described, told, strict=True):
            found.update(fields)

    def _identify(self, meal: Meal, described: Sequence[tuple[Mapping[str, Any], ItemVcm]]) -> list[dict[str, Any]]:
        identifier = self._identifier(meal)
        own = self._eaten(meal)
        day_minute = local_minute(meal.captured_at, meal.time_zone)
        told: list[dict[str, Any]] = []
        for found, vcm in described:
            if vcm.version != identifier.vcm_version:
                told.append({})
                continue
            circumstances = Circumstances(
                volume_ml=found["volume_ml"],
                volume_relative_sd=math.hypot(*found["relative_sd"].values()),
                day_minute=day_minute,
                own=own,
            )
            answer = identifier.identify(vcm.numbers(), circumstances, MOST_SEALED)
            told.append(
                {
                    "candidates": [
                        {"food": one.food_key, "probability": round(one.probability, DECIMALS)}
                        for one in answer.candidates
                    ],
                    "none_probability": round(answer.none_probability, DECIMALS),
                    "index_version": answer.index_version,
                }
            )
        return told

    def _eaten(self, meal: Meal) -> list[Eaten]:
        """What the participant has confirmed before; a food that only the server has named shows no habit."""
        with self._database.read() as session:
            rows = index_entries.eaten_before(session, meal.participant_id, without_meal=meal.id, most=MOST_EATEN)
        return [
            Eaten(row.food_key, local_minute(row.captured_at, row.time_zone))
            for row in rows
            if FOOD_IDENTIFIED not in row.flags
        ]

    def _identifier(self, meal: Meal) -> Identifier:
        """The index with what the meal's study has learned from other meals, made anew where that has changed."""
        index = self._index()
        with self._lock:
            held = self._learned.pop(meal.study_id, None)
            known = held.vectors if held is not None else {}
            with self._database.read() as session:
                found = index_entries.entries_for(
                    session, meal.study_id, index.vcm_version, without_meal=meal.id, most=MOST_EXAMPLES
                )
                new = [entry for entry in found if (entry.item_id, entry.run_id) not in known]
                read = index_entries.vectors_of(session, new, index.vcm_version)
            entries = tuple(found)
            if held is None or held.entries != entries:
                vectors = dict(known) | {key: numbers_of(vector) for key, vector in read.items()}
                kept = {key: vectors[key] for entry in entries if (key := (entry.item_id, entry.run_id)) in vectors}
                length = index.vectors.shape[1]
                usable = {key for key, one in kept.items() if one.shape == (length,) and not np.isnan(one).any()}
                learned = [_example(one, kept) for one in entries if (one.item_id, one.run_id) in usable]
                if len(learned) < len(entries):
                    log.error("vectors_unusable", study_id=str(meal.study_id), count=len(entries) - len(learned))
                held = _Learned(entries, kept, Identifier(index, learned))
            self._learned[meal.study_id] = held
            while len(self._learned) > MOST_STUDIES:
                del self._learned[next(iter(self._learned))]
            return held.identifier


def _example(entry: Entry, vectors: Mapping[tuple[uuid.UUID, uuid.UUID], Vectors]) -> Example:
    return Example(
        name=f"{entry.item_id} {entry.run_id}",
        food_key=entry.food_key,
        vector=vectors[entry.item_id, entry.run_id],
        volume_ml=entry.volume_ml,
        day_minute=entry.day_minute,
        is_own=entry.is_own,
    )
