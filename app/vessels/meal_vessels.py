"""A study's vessels in a meal: hints may name them, and a run records those that it was given."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import JsonValue
from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError
from app.vessels import queries as vessels
from app.vessels.study_vessels import VesselView
from app.vessels.vessel_measures import name_key
from app.vision.vessel_library import VesselModel

Hints = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class VesselsOfMeal:
    """The vessels for an estimate: those in use, and retired ones that a hint names."""

    views: tuple[VesselView, ...]

    @property
    def models(self) -> tuple[VesselModel, ...]:
        """The vessels as the pipeline takes them."""
        return tuple(view.model for view in self.views)

    def in_hints(self, hints: Hints) -> list[Mapping[str, Any]]:
        """Return the hints with the library's spelling of vessels' names, since the pipeline compares exactly."""
        names = {view.vessel.name_key: view.vessel.name for view in self.views}
        return [
            {**hint, "vessel": names.get(name_key(hint["vessel"]), hint["vessel"])}
            if hint.get("vessel")
            else hint
            for hint in hints
        ]

    def note_in(self, parameters: dict[str, JsonValue]) -> None:
        """Record the vessels and their versions in a run's parameters: `parameters.vessels`."""
        if self.views:
            parameters["vessels"] = {view.vessel.name: view.vessel.version for view in self.views}


def vessels_of_meal(session: Session, study_id: uuid.UUID, hints: Hints) -> VesselsOfMeal:
    """Return the study's vessels for an estimate with these hints."""
    rows = vessels.vessels_for_estimate(session, study_id, _hinted_keys(hints))
    return VesselsOfMeal(tuple(VesselView(*row) for row in rows))


def require_known_vessels(session: Session, study_id: uuid.UUID, hints: Hints) -> None:
    """Raises InvalidInputError `vessel_unknown` if a hint names a vessel that the study never had.

    A retired vessel may be named: phones also send meals from days when it was in use.
    """
    keys = _hinted_keys(hints)
    if not keys:
        return
    unknown = keys - vessels.vessel_keys(session, study_id, keys)
    names = sorted(
        {
            str(hint["vessel"])
            for hint in hints
            if hint.get("vessel") and name_key(hint["vessel"]) in unknown
        }
    )
    if names:
        raise InvalidInputError(
            f"The study's vessel library has no {', '.join(names)}: GET /v1/me/vessels lists what it has.",
            code="vessel_unknown",
            vessels=names,
        )


def _hinted_keys(hints: Hints) -> set[str]:
    return {name_key(hint["vessel"]) for hint in hints if hint.get("vessel")}
