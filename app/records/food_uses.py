"""Where a food stands: in which releases, and in the records and measurements of which studies."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from app.db.session import Database
from app.foods import queries as foods
from app.foods.edits import queries as food_uses
from app.foods.edits.queries import FoodVersion
from app.foods.foods import require_food
from app.foods.models import StudyDensity
from app.people.access.caller import StaffCaller, studies_with_role
from app.records.food_use_queries import StudyRecords, records_by_study

COUNTED = 1000  # records of a study; with more, that there are more is told
MOST_STUDIES = 500


@dataclass(frozen=True, slots=True)
class FoodPlace:
    """A version of a food. is_found: whoever asks for the key gets this one; is_in_force: of a release in force."""

    version: FoodVersion
    is_found: bool
    is_in_force: bool


@dataclass(frozen=True, slots=True)
class StudyUse:
    """A study that has the food. of.records: how many of its records; is_more: there are more than those."""

    of: StudyRecords
    is_more: bool
    densities: Sequence[StudyDensity]


@dataclass(frozen=True, slots=True)
class FoodUses:
    """Where a food stands. studies: those that the caller knows and that have it; is_cut: not all were looked at."""

    places: Sequence[FoodPlace]
    studies: Sequence[StudyUse]
    is_cut: bool


def read_uses(database: Database, caller: StaffCaller, key: str) -> FoodUses:
    """Where the food of this key stands, in any version. Records count that hold: nobody has rejected them.

    Raises NotFoundError.
    """
    with database.read() as session:
        food = require_food(session, key)
        versions = food_uses.versions_of(session, food.key)
        in_force = {release.id for release in foods.releases_in_force(session)}
        ids = [version.food.id for version in versions]
        counted = records_by_study(session, ids, studies_with_role(caller), most=COUNTED + 1, studies=MOST_STUDIES + 1)
        looked_at = counted[:MOST_STUDIES]
        measured = foods.densities_of_studies(session, [study.study_id for study in looked_at], food.key)
    studies = [
        StudyUse(
            replace(study, records=min(study.records, COUNTED)),
            study.records > COUNTED,
            [density for density in measured if density.study_id == study.study_id],
        )
        for study in looked_at
    ]
    return FoodUses(
        places=[
            FoodPlace(
                version,
                is_found=version.food.id == food.id,
                is_in_force=version.release.id in in_force and version.food.superseded_by_id is None,
            )
            for version in versions
        ],
        studies=[use for use in studies if use.of.records or use.densities],
        is_cut=len(counted) > MOST_STUDIES,
    )
