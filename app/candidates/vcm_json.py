"""An item's VCM in the pipeline's answer: version and base64 of little-endian float16."""

import base64
from dataclasses import dataclass

import numpy as np
from pydantic import Base64Bytes

from app.identification.examples import Example
from app.identification.metric import Vectors
from app.meals.stored.run_answer import VcmAnswer
from app.vision.looks.vcm import LENGTH, LENGTHS, VCM_VERSION
from app.vision.model import Float32Array

FLOAT = np.dtype("<f2")


def vcm_answer(vector: Float32Array) -> VcmAnswer:
    """Encode a vector (d,) of the pipeline's VCM_VERSION in float16, the precision of the index."""
    return VcmAnswer(version=VCM_VERSION, vector=base64.b64encode(vector.astype(FLOAT).tobytes()))


def numbers_of(vector: bytes) -> Vectors:
    """Decode a stored vector: (d,) float64."""
    return np.frombuffer(vector, FLOAT).astype(np.float64)


@dataclass(frozen=True, slots=True)
class StoredPiece:
    """A food that was seen, as it is stored. vector: of its views, one after the other."""

    name: str
    food_key: str
    vcm_version: str
    vector: Base64Bytes
    volume_ml: float | None = None
    day_minute: int = 720
    eater: str | None = None

    def examples(self) -> list[Example]:
        """Return an example for each view.

        A vector of an earlier version lacks its last numbers: they are NaN (Metric.embed). Returns
        none if the version is unknown or a vector is damaged: one such would spoil all answers.
        """
        length = LENGTHS.get(self.vcm_version)
        if length is None:  # also what was erased, of which nothing is kept
            return []
        numbers = numbers_of(self.vector)
        if len(numbers) % length or not np.isfinite(numbers).all():
            return []
        views = numbers.reshape(-1, length)
        return [
            Example(
                name=f"{self.name} {number}" if number else self.name,
                food_key=self.food_key,
                vector=np.pad(view, (0, LENGTH - length), constant_values=np.nan),
                volume_ml=self.volume_ml,
                day_minute=self.day_minute,
                eater=self.eater,
                share=1.0 / len(views),
            )
            for number, view in enumerate(views)
        ]
