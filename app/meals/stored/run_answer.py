"""The answer of a run of the pipeline: the child's JSON, sealed in the blob store as result.json.

Fields that are not set are not written, so that an item which was not identified has no
`index_version`.
"""

import uuid
from typing import Any, Self

from pydantic import Base64Bytes, BaseModel, ConfigDict, Field, JsonValue

from app.core.errors import Failure
from app.meals.stored.outline_json import Polygon, rings_of

Json = dict[str, JsonValue]


class _Answer(BaseModel):
    model_config = ConfigDict(extra="ignore")

    def as_json(self) -> Json:
        """Return the answer as stored and printed."""
        return self.model_dump(mode="json", exclude_unset=True)


class VcmAnswer(_Answer):
    """An item's feature vector: little-endian float16, base64 in JSON."""

    version: str
    vector: Base64Bytes


# What is so likely is assigned without asking. A wrong food must not enter sums unnoticed: of those
# that the index does not know, 3 in 100 reach this.
SURE_FROM, GROUP_SURE_FROM = 0.85, 0.9
# of a food that is assigned: of dishes known by two specimens, a quarter of such were others
FEWEST_SPECIMENS = 3


class CandidateAnswer(_Answer):
    """A food by its key, with its probability by the index or a network.

    specimens: pieces or servings that the index knows it by; None: a network's
    is_group: of foods, which are candidates themselves
    reasons: what speaks for or against it beside its looks (identification/identifier.py)
    """

    food: str
    probability: float
    specimens: int | None = None
    is_group: bool = False
    reasons: list[str] = []

    @property
    def is_sure(self) -> bool:
        """Return whether it is likely and known well enough that nobody need be asked."""
        is_likely = self.probability >= (GROUP_SURE_FROM if self.is_group else SURE_FROM)
        return is_likely and (self.specimens is None or self.specimens >= FEWEST_SPECIMENS)


class ItemAnswer(_Answer):
    """One food. polygon: a ring, or several. hint: position of the hint that it answers.

    candidates, none_probability, index_version: by the index; index_version None: not identified
    model_candidates: by an operator's network
    """

    polygon: Polygon
    volume_ml: float | None
    volume_interval_ml: list[float] | None
    relative_sd: dict[str, float]
    candidates: list[CandidateAnswer] = Field(default_factory=list)
    model_candidates: list[CandidateAnswer] = Field(default_factory=list)
    hint: int | None = None
    flags: list[str]
    traits: Json = Field(default_factory=dict)
    vcm: VcmAnswer | None = None
    none_probability: float | None = None
    index_version: str | None = None

    def columns(self) -> dict[str, Any]:
        """Return the columns that an item and its measurement have in common."""
        low_ml, high_ml = self.volume_interval_ml or (None, None)
        return {
            "rings": rings_of(self.polygon),
            "volume_ml": self.volume_ml,
            "volume_low_ml": low_ml,
            "volume_high_ml": high_ml,
            "relative_sd": self.relative_sd,
            "flags": self.flags,
        }


class ArtefactAnswer(_Answer):
    """A picture or point cloud of one step; blob_key: empty until it is sealed."""

    name: str
    media_type: str
    bytes: int
    sha256: str
    blob_key: str = ""


class RunAnswer(_Answer):
    """marker: None for a rig.

    second: slot of the photograph that camera_right is of, and `colour` beside the left one.
    regions: for a run on regions that people drew, the item of each hint.
    """

    items: list[ItemAnswer]
    failure: Failure | None
    marker: str | None
    camera: Json | None
    camera_right: Json | None
    second: str = "right"
    colour: Json | None = None
    stages: dict[str, float]
    seconds: float
    method: str
    pipeline_version: str
    parameters: Json
    artefacts: list[ArtefactAnswer] = Field(default_factory=list)
    regions: list[uuid.UUID] = Field(default_factory=list)

    @classmethod
    def read(cls, content: bytes | str) -> Self:
        """Parse a sealed answer."""
        return cls.model_validate_json(content)

    def write(self) -> bytes:
        """Return the bytes to seal."""
        return self.model_dump_json(exclude_unset=True).encode()


# The width of the small pictures of a pair's photographs among a run's artefacts, so that a gallery need not decode
# photographs. They are upright, colour-corrected by the marker and without metadata, like those of serve_photo.py at
# this width; like other artefacts they are served with an entry in the audit log, erased, and backed up.
THUMBNAIL_PX = 320


def thumbnail_name(slot: str) -> str:
    """Return the artefact's name in a run on the slot's pair."""
    return f"thumbnail_{slot.removeprefix('after_')}.jpg"
