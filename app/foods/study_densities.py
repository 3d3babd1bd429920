"""A study's own measurements of foods' densities: they take precedence in that study only; withdrawn, never deleted."""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.db.session import Database
from app.foods.edits import queries as food_changes
from app.foods.edits.edit_food import Editor
from app.foods.foods import require_food
from app.foods.models import StudyDensity
from app.nutrition.foods import Density
from app.nutrition.plausible import MAX_G_PER_ML, MIN_G_PER_ML
from app.nutrition.portion_density import Specimen, median_density
from app.people.access.audit import note
from app.people.studies import load_study


def density_of_specimens(
    specimens: Sequence[Specimen], volume_step_ml: float
) -> tuple[float, float]:
    """Return (median, spread) of the specimens, g/ml.

    Raises InvalidInputError if they are too few or impossible.
    """
    for number, specimen in enumerate(specimens, start=1):
        if specimen.g_per_ml > MAX_G_PER_ML:
            raise InvalidInputError(
                f"Specimen {number} has {specimen.g_per_ml:.2f} g/ml, more than any food: are volume and mass swapped?",
                code="density_impossible",
            )
    try:
        g_per_ml, sd_g_per_ml = median_density(specimens, volume_step_ml=volume_step_ml)
    except ValueError as error:
        raise InvalidInputError(
            f"No density follows: {error}.", code="density_impossible"
        ) from None
    if g_per_ml < MIN_G_PER_ML or sd_g_per_ml > g_per_ml:
        raise InvalidInputError(
            f"The specimens give {g_per_ml:.3g} +- {sd_g_per_ml:.3g} g/ml, which no food has: are they of one food, "
            "and were their volumes read precisely enough?",
            code="density_impossible",
        )
    return g_per_ml, sd_g_per_ml


DENSITY_COLUMNS = ("g_per_ml", "sd_g_per_ml", "state", "kind", "weighs", "source")


@dataclass(frozen=True, slots=True)
class Measurement:
    """A density that a study measured.

    density.source: the method. specimens: the measurements it was computed from.
    """

    food: str
    density: Density
    specimens: Sequence[Specimen] = ()
    measured_at: datetime | None = None


def add_study_density(
    database: Database, study_code: str, measurement: Measurement, editor: Editor
) -> StudyDensity:
    """Store a study's measurement. Raises NotFoundError if there is no such study or food."""
    now, density = datetime.now(UTC), measurement.density
    if measurement.measured_at is not None and measurement.measured_at > now:
        raise InvalidInputError("A measurement cannot be in the future.", code="time_impossible")
    with database.write() as session:
        row = StudyDensity(
            id=uuid.uuid4(),
            study_id=load_study(session, study_code).id,
            food_key=require_food(session, measurement.food).key,
            **{name: getattr(density, name) for name in DENSITY_COLUMNS},
            specimens=[[specimen.volume_ml, specimen.mass_g] for specimen in measurement.specimens]
            or None,
            author=editor.author,
            reason=editor.reason,
            measured_at=(measurement.measured_at or now).astimezone(UTC),
            created_at=now,
        )
        session.add(row)
        note(
            session,
            editor.caller,
            "density.add",
            study_id=row.study_id,
            subject=row.food_key,
            density=str(row.id),
        )
    return row


def list_study_densities(
    database: Database, study_code: str, food: str | None = None
) -> list[StudyDensity]:
    """Return a study's measurements, withdrawn ones too, the newest entry first.

    Raises NotFoundError.
    """
    with database.read() as session:
        study = load_study(session, study_code)
        return food_changes.all_study_densities(session, study.id, food)


def withdraw_study_density(
    database: Database, study_code: str, density_id: uuid.UUID, editor: Editor
) -> StudyDensity:
    """Withdraw a measurement. Raises NotFoundError; ConflictError if it is withdrawn already."""
    with database.write() as session:
        study = load_study(session, study_code)
        now = datetime.now(UTC)
        is_withdrawn = food_changes.withdraw(
            session, study.id, density_id, editor.author, editor.reason, now
        )
        row = session.get(StudyDensity, density_id)
        if row is None or row.study_id != study.id:
            raise NotFoundError(
                f"Study {study_code!r} has no density {density_id}.", code="density_not_found"
            )
        if not is_withdrawn:
            raise ConflictError("This density is withdrawn already.", code="density_withdrawn")
        note(
            session,
            editor.caller,
            "density.withdraw",
            study_id=study.id,
            subject=row.food_key,
            density=str(row.id),
        )
        return row
