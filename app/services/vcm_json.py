"""The VCM of an item as the pipeline's answer carries it: version and base64 of little-endian float16."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.identification.metric import Vectors

FLOAT = np.dtype("<f2")


@dataclass(frozen=True, slots=True)
class ItemVcm:
    """vector: as it is kept, little-endian float16."""

    version: str
    vector: bytes

    def numbers(self) -> Vectors:
        """(d,) float64."""
        return numbers_of(self.vector)


def vcm_of(found: Mapping[str, Any]) -> ItemVcm | None:
    """Of an item of the answer; None where it was not described, as in answers of a pipeline before there was VCM."""
    vcm = found.get("vcm")
    return ItemVcm(vcm["version"], base64.b64decode(vcm["vector"])) if vcm is not None else None


def numbers_of(vector: bytes) -> Vectors:
    """(d,) float64 of a kept vector."""
    return np.frombuffer(vector, FLOAT).astype(np.float64)
