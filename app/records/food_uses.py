"""Where a food is used: its releases, and the records and density measurements of each study."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from app.db.session import Database
from app.foods import queries as foods
from app.foods.edits import queries as food_edits
from app.foods.edits.queries import FoodVersion
from app.foods.foods import require_food
from app.foods.models import StudyDensity
from app.people.access.caller import StaffCaller, studies_with_role
from app.records.queries import StudyRecords, records_by_study

COUNTED = 1000  # records of a study; beyond it, only that there are more
MOST_STUDIES = 500


@dataclass(frozen=True, slots=True)
class FoodPlace:
    """A version of a food.

    is_found: a look-up by key returns this one; is_in_force: in a release in force
    """

    version: FoodVersion
    is_found: bool
    is_in_force: bool


@dataclass(frozen=True, slots=True)
class StudyUse:
    """A study that uses the food.

    of.records: its records, at most COUNTED; is_more: it has more than those.
    """

    of: StudyRecords
    is_more: bool
    densities: Sequence[StudyDensity]


@dataclass(frozen=True, slots=True)
class FoodUses:
    """Uses of a food.

    studies: those that the caller may see and that use it; is_cut: not all studies were read
    """

    places: Sequence[FoodPlace]
    studies: Sequence[StudyUse]
    is_cut: bool


def read_uses(database: Database, caller: StaffCaller, key: str) -> FoodUses:
    """Return the uses of all versions of the food with this key; rejected records do not count.

    Raises NotFoundError.
    """
    with database.read() as session:
        food = require_food(session, key)
        versions = food_edits.versions_of(session, food.key)
        in_force = {release.id for release in foods.releases_in_force(session)}
        ids = [version.food.id for version in versions]
        counted = records_by_study(
            session, ids, studies_with_role(caller), most=COUNTED + 1, studies=MOST_STUDIES + 1
        )
        looked_at = counted[:MOST_STUDIES]
        measured = foods.densities_of_studies(
            session, [study.study_id for study in looked_at], food.key
        )
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
                is_in_force=version.release.id in in_force
                and version.food.superseded_by_id is None,
            )
            for version in versions
        ],
        studies=[use for use in studies if use.of.records or use.densities],
        is_cut=len(counted) > MOST_STUDIES,
    )
