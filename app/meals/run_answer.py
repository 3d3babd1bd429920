"""What a run of the pipeline answers: the child's JSON, sealed in the store as result.json.

Fields that are not set are not written, so that an item which no index has seen has no `index_version`.
"""

import uuid
from typing import Self

from pydantic import Base64Bytes, BaseModel, ConfigDict, Field, JsonValue

from app.core.errors import Failure
from app.meals.event_values import Polygon

Json = dict[str, JsonValue]


class _Answer(BaseModel):
    model_config = ConfigDict(extra="ignore")

    def as_json(self) -> Json:
        """As it is kept and printed."""
        return self.model_dump(mode="json", exclude_unset=True)


class VcmAnswer(_Answer):
    """What an item looks like. vector: little-endian float16, base64 in JSON."""

    version: str
    vector: Base64Bytes


class CandidateAnswer(_Answer):
    """A food by its key, and how probable the index thinks it."""

    food: str
    probability: float


class ItemAnswer(_Answer):
    """One food. polygon: a ring, or several. hint: place of the hint that it answers.

    candidates, none_probability, index_version: by the index; version None: it was not asked.
    """

    polygon: Polygon
    volume_ml: float | None
    volume_interval_ml: list[float] | None
    relative_sd: dict[str, float]
    candidates: list[CandidateAnswer] = Field(default_factory=list)
    hint: int | None = None
    flags: list[str]
    traits: Json = Field(default_factory=dict)
    vcm: VcmAnswer | None = None
    none_probability: float | None = None
    index_version: str | None = None

    @property
    def interval_ml(self) -> tuple[float | None, float | None]:
        """Both ends of the volume's 90 % interval."""
        low_ml, high_ml = self.volume_interval_ml or (None, None)
        return low_ml, high_ml


class ArtefactAnswer(_Answer):
    """A picture or a point cloud of one step; blob_key: once it is sealed."""

    name: str
    media_type: str
    bytes: int
    sha256: str
    blob_key: str = ""


class RunAnswer(_Answer):
    """marker: None for a rig. regions: for a run on regions that people drew, the item of each hint."""

    items: list[ItemAnswer]
    failure: Failure | None
    marker: str | None
    camera: Json | None
    camera_right: Json | None
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
        """The sealed answer."""
        return cls.model_validate_json(content)

    def write(self) -> bytes:
        """As it is sealed."""
        return self.model_dump_json(exclude_unset=True).encode()
