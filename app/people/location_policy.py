"""What a study keeps of where a meal was eaten: dropped, rounded or kept, decided before anything is sealed.

"drop": nothing. "round": latitude and longitude to so many decimals of a degree, from the metadata, else from the
photographs' own tags; the tags are cut all the same. "keep": as told, and the tags stay.
"""

import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.people.models import Study
from app.photos.gps import Location


@dataclass(frozen=True, slots=True)
class LocationPolicy:
    """One study's. decimals: of degrees, for "round" only."""

    kind: str
    decimals: int | None = None

    @property
    def cuts_tags(self) -> bool:
        """Whether the photographs lose their location tags before they are sealed."""
        return self.kind != "keep"

    @property
    def reads_tags(self) -> bool:
        """Whether the location is taken from the photographs where the metadata tell none."""
        return self.kind == "round"

    def kept(self, told: Mapping[str, float] | None, found: Iterable[Location | None] = ()) -> dict[str, float] | None:
        """The location to be stored. told: as the metadata have it; found: what the photographs' tags said."""
        if self.kind == "keep":
            return dict(told) if told else None
        if self.kind != "round":
            return None
        if told:
            return self._rounded(told["latitude"], told["longitude"])
        first = next(filter(None, found), None)
        return self._rounded(first.latitude_deg, first.longitude_deg) if first else None

    def _rounded(self, latitude_deg: float, longitude_deg: float) -> dict[str, float]:
        """Without the accuracy: beside a rounded place it would only say how well the phone knew the exact one."""
        return {
            "latitude": round(latitude_deg, self.decimals or 0),
            "longitude": round(longitude_deg, self.decimals or 0),
        }


def policy_of(study: Study) -> LocationPolicy:
    """The study's policy as it is now."""
    return LocationPolicy(study.location_policy, study.location_decimals)


@dataclass(frozen=True, slots=True)
class FilesWithPlaces:
    """What is done with a study's files that may hold places once the study begins to drop them.

    take_back: by each domain that makes such files. Queries leave places out from then on; finished exports expire,
    what is being made begins again. A release that is frozen keeps what it has: that is what it is for, and its
    release.json says of how many meals.
    """

    take_back: Sequence[Callable[[Session, uuid.UUID], object]]

    def __call__(self, session: Session, study: Study) -> None:
        """In the transaction of the study's change."""
        for take_back in self.take_back:
            take_back(session, study.id)
