"""The VCM of an item as the pipeline's answer carries it: version and base64 of little-endian float16."""

import base64

import numpy as np

from app.identification.metric import Vectors
from app.meals.run_answer import VcmAnswer
from app.vision.looks.vcm import VCM_VERSION
from app.vision.model import Float32Array

FLOAT = np.dtype("<f2")


def vcm_answer(vector: Float32Array) -> VcmAnswer:
    """(d,) of the pipeline's VCM_VERSION; float16 is as fine as its measures are, and what the index is made of."""
    return VcmAnswer(version=VCM_VERSION, vector=base64.b64encode(vector.astype(FLOAT).tobytes()))


def numbers_of(vector: bytes) -> Vectors:
    """(d,) float64 of a kept vector."""
    return np.frombuffer(vector, FLOAT).astype(np.float64)
