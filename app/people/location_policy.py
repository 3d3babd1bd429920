"""A study's policy on where meals were eaten, applied before anything is sealed.

"drop": nothing is kept. "round": latitude and longitude, from the metadata or else from the
photographs' tags, to some decimals of a degree; the tags are removed. "keep": the metadata and the
tags are kept.
"""

import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.people.models import Study
from app.photos.gps import Location


@dataclass(frozen=True, slots=True)
class LocationPolicy:
    """A study's policy. decimals: of degrees, for "round" only."""

    kind: str
    decimals: int | None = None

    @property
    def cuts_tags(self) -> bool:
        """Whether location tags are removed from photographs before they are sealed."""
        return self.kind != "keep"

    @property
    def reads_tags(self) -> bool:
        """Whether the location comes from the photographs' tags if the metadata have none."""
        return self.kind == "round"

    def apply(
        self, sent: Mapping[str, float] | None, tagged: Iterable[Location | None] = ()
    ) -> dict[str, float] | None:
        """Return the location to store. sent: in the metadata; tagged: in the photographs' tags."""
        if self.kind == "keep":
            return dict(sent) if sent else None
        if self.kind != "round":
            return None
        if sent:
            return self._round(sent["latitude"], sent["longitude"])
        first = next(filter(None, tagged), None)
        return self._round(first.latitude_deg, first.longitude_deg) if first else None

    def _round(self, latitude_deg: float, longitude_deg: float) -> dict[str, float]:
        """Round a location and drop its accuracy, which is that of the exact location."""
        return {
            "latitude": round(latitude_deg, self.decimals or 0),
            "longitude": round(longitude_deg, self.decimals or 0),
        }


def policy_of(study: Study) -> LocationPolicy:
    """Return a study's current policy."""
    return LocationPolicy(study.location_policy, study.location_decimals)


@dataclass(frozen=True, slots=True)
class FilesWithPlaces:
    """Invalidates a study's files that may contain places when the study changes its policy to "drop".

    take_back: a function of each domain that makes such files. From then on queries leave out
    places, finished exports expire and running ones start again. Frozen releases keep their places;
    datapackage.json tells the number of meals.
    """

    take_back: Sequence[Callable[[Session, uuid.UUID], object]]

    def __call__(self, session: Session, study: Study) -> None:
        """Invalidate the files in the transaction of the study's change."""
        for take_back in self.take_back:
            take_back(session, study.id)
