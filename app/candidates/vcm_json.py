"""The VCM of an item as the pipeline's answer carries it: version and base64 of little-endian float16."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.identification.metric import Vectors
from app.vision.looks.vcm import VCM_VERSION
from app.vision.model import Float32Array

FLOAT = np.dtype("<f2")


@dataclass(frozen=True, slots=True)
class ItemVcm:
    """vector: as it is kept, little-endian float16."""

    version: str
    vector: bytes

    def numbers(self) -> Vectors:
        """(d,) float64."""
        return numbers_of(self.vector)


def vcm_to_json(vector: Float32Array) -> dict[str, str]:
    """(d,) of the pipeline's VCM_VERSION; float16 is as fine as its measures are, and what the index is made of."""
    return {"version": VCM_VERSION, "vector": base64.b64encode(vector.astype(FLOAT).tobytes()).decode()}


def vcm_from_json(value: Mapping[str, str]) -> ItemVcm:
    """The reverse of vcm_to_json."""
    return ItemVcm(value["version"], base64.b64decode(value["vector"]))


def vcm_of(found: Mapping[str, Any]) -> ItemVcm | None:
    """Of an item of the answer; None where it was not described, as in answers of a pipeline before there was VCM."""
    vcm = found.get("vcm")
    return vcm_from_json(vcm) if vcm is not None else None


def numbers_of(vector: bytes) -> Vectors:
    """(d,) float64 of a kept vector."""
    return np.frombuffer(vector, FLOAT).astype(np.float64)
