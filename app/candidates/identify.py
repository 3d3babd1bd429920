"""Rank the foods of each item in a run's answer, by the index, the study's confirmed items and the eater's habits.

Runs in the worker, after the child has described the regions and before the answer is sealed, so that saving the answer
is reproducible. A failure never fails the meal: the items then have no candidates. If the database is unavailable, the
job is retried.
"""

import math
from collections.abc import Callable, Sequence

import structlog
from sqlalchemy.exc import SQLAlchemyError

from app.candidates import queries as index_entries
from app.candidates.learned_index import LearnedIndex
from app.candidates.scale_doubt import note_doubtful_scale
from app.candidates.vcm_json import numbers_of
from app.children.faults import is_passing
from app.db.session import Database
from app.identification.food_index import FoodIndex, shipped_index
from app.identification.habits import Eaten
from app.identification.identifier import Circumstances, Identification, Identifier
from app.meals.stored.item_state import FOOD_IDENTIFIED
from app.meals.stored.meal_time import local_minute
from app.meals.stored.models import Meal
from app.meals.stored.run_answer import CandidateAnswer, ItemAnswer, RunAnswer, VcmAnswer

log = structlog.get_logger()

MOST_SEALED = 20  # per item; fewer are saved (save_candidates.py), since a table may lack some
MOST_EATEN = 300  # a participant's items of some weeks
DECIMALS = 6


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
                    item.candidates = [
                        CandidateAnswer(
                            food=each.food_key, probability=round(each.probability, DECIMALS)
                        )
                        for each in identification.candidates
                    ]
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
            identified.append(
                identifier.identify(numbers_of(vcm.vector), circumstances, MOST_SEALED)
            )
        return identified

    def _confirmed_foods(self, meal: Meal) -> list[Eaten]:
        """Return the foods that the participant has confirmed; one that only the server identified shows no habit."""
        with self._database.read() as session:
            rows = index_entries.eaten_before(
                session, meal.participant_id, without_meal=meal.id, most=MOST_EATEN
            )
        return [
            Eaten(row.food_key, local_minute(row.captured_at, row.time_zone))
            for row in rows
            if FOOD_IDENTIFIED not in row.flags
        ]
