"""A rendered ball beside the board, measured once for all tests that show it."""

from functools import cache

from app.vision.model import EstimateOptions, MealEstimate, PhotoPair
from app.vision.pipeline import estimate_meal
from tests.unit.vision.stereo_scene import CAMERA, SPEC, Ball, rendered_views

BALL = Ball((115.0, 15.0), 33.0)


@cache
def measured_ball() -> tuple[PhotoPair, MealEstimate]:
    """The photographs, and the estimate with its artefacts."""
    pair = PhotoPair(*(view.photo for view in rendered_views(BALL)))
    return pair, estimate_meal(pair, EstimateOptions(SPEC, CAMERA), want_artefacts=True)
