"""An item's VCM in the pipeline's answer: version and base64 of little-endian float16."""

import base64

import numpy as np

from app.identification.metric import Vectors
from app.meals.stored.run_answer import VcmAnswer
from app.vision.looks.vcm import VCM_VERSION
from app.vision.model import Float32Array

FLOAT = np.dtype("<f2")


def vcm_answer(vector: Float32Array) -> VcmAnswer:
    """Encode a vector (d,) of the pipeline's VCM_VERSION in float16, the precision of the index."""
    return VcmAnswer(version=VCM_VERSION, vector=base64.b64encode(vector.astype(FLOAT).tobytes()))


def numbers_of(vector: bytes) -> Vectors:
    """Decode a stored vector: (d,) float64."""
    return np.frombuffer(vector, FLOAT).astype(np.float64)
