"""Rank the foods of each item in a run's answer, by the index, the study's confirmed items and the eater's habits.

Runs in the worker, after the child has described the regions and before the answer is sealed, so
that saving the answer is reproducible. A failure never fails the meal: the items then have no
candidates. If the database is unavailable, the job is retried.

The index is extended by each study's confirmed items, which are read once and then as they change.
Whatever is confirmed, undone, rejected, erased or taught counts from the next meal on. A run whose
marker
was probably declared at a wrong size, judged by what stands around it, is flagged.
"""

import math
import threading
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from functools import cached_property
from typing import cast

import structlog
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.candidates import queries as index_entries
from app.candidates.food_groups import DECIMALS, candidate_answers, groups_of_foods
from app.candidates.queries import AnyRow
from app.candidates.vcm_json import StoredPiece, numbers_of
from app.children.faults import is_passing
from app.db.session import Database
from app.identification.examples import Example, Examples, NumberedIndex
from app.identification.food_index import FoodIndex, shipped_index
from app.identification.habits import Eaten
from app.identification.identifier import Circumstances, Identification, Identifier
from app.identification.sizes import FoodSize, MeasuredFood, plausible_factor
from app.meals.stored.item_state import FOOD_IDENTIFIED, SCALE_DOUBTFUL
from app.meals.stored.meal_time import local_minute
from app.meals.stored.models import HintDetails, Meal
from app.meals.stored.run_answer import SURE_FROM, ItemAnswer, RunAnswer, VcmAnswer
from app.people.models import Study
from app.people.tombstones import public_digest
from app.vision.looks.vcm import LENGTHS

log = structlog.get_logger()

MOST_SEALED = 20  # per item; fewer are saved (item_candidates.py), since a table may lack some
MOST_OF_EATER = 300  # a participant's items of some weeks


class IdentifyFoods:
    """The use case; one per worker process. index: read when it is first needed."""

    def __init__(self, database: Database, index: Callable[[], FoodIndex] = shipped_index) -> None:
        self._database = database
        self._learned = LearnedIndex(database, index)

    def add_candidates(self, meal: Meal, answer: RunAnswer) -> None:
        """Set for each described item of the answer `candidates`, `none_probability` and `index_version`.

        A scale that the sizes of dishes and foods speak against is flagged.
        Raises SQLAlchemyError for a passing fault of the database (app/children/faults.py).
        """
        described = [(item, item.vcm) for item in answer.items if item.vcm is not None]
        if not described:
            return
        try:
            of_meal = self._circumstances(meal)
            hints = _hints(meal, answer)
            with self._learned.identifier_for(meal) as identifier:
                identified = [_identify(item, vcm, of_meal, identifier) for item, vcm in described]
                foods = [
                    _sure_food(item, hints, identification)
                    for (item, _), identification in zip(described, identified, strict=True)
                ]
                for place, (item, vcm) in enumerate(described):
                    others = foods[:place] + foods[place + 1 :]
                    of_item = replace(of_meal, beside=frozenset(filter(None, others)))
                    if of_item.has_company:
                        identified[place] = _identify(item, vcm, of_item, identifier)
                for (item, _), identification in zip(described, identified, strict=True):
                    if identification is not None:
                        item.candidates = candidate_answers(identification)[:MOST_SEALED]
                        item.none_probability = round(identification.none_probability, DECIMALS)
                        item.index_version = identification.index_version
                note_doubtful_scale(meal, answer, identifier)
        # any bug: the volumes are computed, and a person can name the foods
        except Exception as error:
            if isinstance(error, SQLAlchemyError) and is_passing(error):
                raise  # the database is unavailable, and a run's candidates are written only once
            log.exception("identify_failed", meal_id=str(meal.id))

    def _circumstances(self, meal: Meal) -> Circumstances:
        """Return the hour and what the participant has confirmed.

        What only the server named shows no habit.
        """
        with self._database.read() as session:
            if not session.get_one(Study, meal.study_id).identifies_by_context:
                return Circumstances(looks_alone=True)
            rows = index_entries.eaten_before(
                session, meal.participant_id, without_meal=meal.id, most=MOST_OF_EATER
            )
        foods_at: dict[datetime, set[str]] = {}
        for row in rows:
            foods_at.setdefault(row.captured_at, set()).add(row.food_key)
        return Circumstances(
            day_minute=local_minute(meal.captured_at, meal.time_zone),
            own=[
                Eaten(
                    row.food_key,
                    local_minute(row.captured_at, row.time_zone),
                    frozenset(foods_at[row.captured_at] - {row.food_key}),
                )
                for row in rows
                if FOOD_IDENTIFIED not in row.flags
            ],
            eater=str(meal.participant_id),
        )


def _hints(meal: Meal, answer: RunAnswer) -> Sequence[HintDetails]:
    """Return the hints that the answer's items name: none in a run on redrawn regions."""
    return meal.details["hints"] if not answer.regions else []


def _sure_food(
    item: ItemAnswer, hints: Sequence[HintDetails], identification: Identification | None
) -> str | None:
    """Return the food of an item beside others: its hint's, or what it is surely by its looks."""
    if hints and item.hint is not None and (food := hints[item.hint].get("food")):
        return food
    best = identification.candidates[0] if identification is not None else None
    return best.food_key if best is not None and best.probability >= SURE_FROM else None


def _identify(
    item: ItemAnswer, vcm: VcmAnswer, of_meal: Circumstances, identifier: Identifier
) -> Identification | None:
    """Identify an item; None if it was described by another version than the index's."""
    if vcm.version != identifier.vcm_version:
        return None
    relative_sd = math.hypot(*item.relative_sd.values())
    circumstances = replace(of_meal, volume_ml=item.volume_ml, volume_relative_sd=relative_sd)
    return identifier.identify(numbers_of(vcm.vector), circumstances)


# a parameter of the run: what all lengths should be multiplied by
PLAUSIBLE_FACTOR = "plausible_scale_factor"


def note_doubtful_scale(meal: Meal, answer: RunAnswer, identifier: Identifier) -> None:
    """Flag the items, and note the factor, where the sizes of dishes and foods contradict the marker's."""
    if answer.parameters.get("scale_source") != "marker":
        return
    lengths_mm = dict(cast(dict[str, list[float]], answer.parameters.get("rim_radii_mm", {})))
    lengths_mm["camera"] = [cast(float, answer.parameters["camera_height_first_mm"])]
    hints = _hints(meal, answer)
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


# entries, 1.3 kB each, beyond which studies that the meal does not need are forgotten
MOST_HELD = 400_000


class LearnedIndex:
    """The examples of studies; one per worker process, shared by its threads.

    Each study's are read once, then those that have changed: each change of an entry gives its
    item's record the study's next change number, each erasure leaves a tombstone with one.
    Photographs that teach a study are few: they are read again whenever there are others. They are
    no evidence of what is eaten, so they stand apart from the study's confirmed items.
    """

    def __init__(self, database: Database, index: Callable[[], FoodIndex]) -> None:
        self._database, self._index = database, index
        # study -> its examples, as they were after its change of a number; the last used at the end
        self._learned: dict[uuid.UUID, tuple[Examples, int]] = {}
        # study -> the photographs that teach it, and their ids
        self._taught: dict[uuid.UUID, tuple[Examples, frozenset[uuid.UUID]]] = {}
        self._lock = threading.Lock()

    @cached_property
    def _numbered(self) -> NumberedIndex:
        return NumberedIndex(self._index())

    @contextmanager
    def identifier_for(self, meal: Meal) -> Iterator[Identifier]:
        """Yield the index with what the meal's study and sharing ones learned, but of other meals."""
        with self._lock:
            with self._database.read() as session:
                used = {
                    study_id: self._brought_up(session, study_id, change_seq)
                    for study_id, change_seq in index_entries.studies_for(session, meal.study_id)
                }
                taught = self._taught_to(session, meal.study_id)
                of_meal = index_entries.entries_of_meal(session, meal.id)
            held = self._learned
            while len(held) > len(used) and sum(len(each) for each, _ in held.values()) > MOST_HELD:
                del held[next(iter(held))]
            own = used.pop(meal.study_id)
            left_out = own.take(map(str, of_meal))
            try:
                others = [*used.values(), taught]
                yield Identifier(self._numbered, own, others, groups=groups_of_foods())
            finally:
                own.append(*left_out)

    def _brought_up(self, session: Session, study_id: uuid.UUID, change_seq: int) -> Examples:
        """A study's examples as they are now. If this fails, they are read anew next time."""
        unread = Examples(self._numbered), index_entries.BEFORE_ALL
        examples, after = self._learned.pop(study_id, unread)
        if after != change_seq:
            for entries in index_entries.changed_entries(session, study_id, after):
                examples.take(str(entry.item_id) for entry in entries)
                examples.put(_examples(study_id, entries))
            if erased := index_entries.erased_digests(session, study_id, after):
                examples.take([name for name in examples.names if public_digest(name) in erased])
        self._learned[study_id] = examples, change_seq
        return examples

    def _taught_to(self, session: Session, study_id: uuid.UUID) -> Examples:
        """The photographs that teach a study now."""
        ids = index_entries.taught_ids(session, study_id)
        examples, ids_before = self._taught.get(study_id, (Examples(self._numbered), frozenset()))
        if ids != ids_before:
            examples = Examples(self._numbered)
            for row in index_entries.taught_photographs(session, study_id):
                if row.id in ids:
                    piece = StoredPiece(str(row.id), row.food_key, row.vcm_version, row.vector)
                    examples.put(piece.examples())
            self._taught[study_id] = examples, ids
        return examples


def _examples(study_id: uuid.UUID, entries: Sequence[AnyRow]) -> list[Example]:
    """Return the entries whose vectors can be compared."""
    examples, damaged = [], 0
    for entry in entries:
        piece = StoredPiece(
            str(entry.item_id),
            entry.food_key,
            entry.vcm_version,
            entry.vector,
            entry.volume_ml,
            entry.day_minute,
            str(entry.participant_id),
        )
        views = piece.examples()
        damaged += not views and entry.vcm_version in LENGTHS
        examples += views
    if damaged:
        log.error("vectors_unusable", study_id=str(study_id), count=damaged)
    return examples
