"""The founding paper's flow chart (Figure 3): photographs in, the volume of each food out.

Photographs arrive decoded (photograph/photo.py); densities and nutrients are for others. Which
inputs are believed, and what is tried where a run fails, is for fallbacks.py.
"""

from collections.abc import Callable
from dataclasses import asdict

from app.core.errors import Failure
from app.vision.describe import describe_items, missed_hints
from app.vision.fallbacks import Items, place_views, run_with_fallbacks
from app.vision.figures import draw_artefacts
from app.vision.measure import measure_foods
from app.vision.model import EstimateOptions, MealEstimate, PhotoPair
from app.vision.scene.liquids import segment_meal
from app.vision.solids.outlines import draw_hints, photograph_px
from app.vision.stages import Stages
from app.vision.trace import Trace
from app.vision.tuning import TUNING
from app.vision.version import PIPELINE_VERSION
from app.vision.views.reconstruct import reconstruct_scene


def estimate_meal(
    pair: PhotoPair,
    options: EstimateOptions,
    *,
    on_stage: Callable[[str], None] = lambda _: None,
    want_artefacts: bool = False,
) -> MealEstimate:
    """Return the volumes of the foods in a stereo pair, or in one photograph.

    on_stage hears each stage's name as it begins. MealEstimate.failure says what the photographs do
    not allow; views and artefacts show how far the run came.
    """
    stage = Stages(on_stage)
    run = run_with_fallbacks(pair, options, stage, _run_steps)
    return MealEstimate(
        method=options.method,
        pipeline_version=PIPELINE_VERSION,
        stages=stage.seconds,
        items=run.items,
        failure=run.failure,
        views=run.trace.views,
        parameters={"seed": options.seed, **run.trace.parameters(), "tuning": asdict(TUNING)},
        artefacts=draw_artefacts(run.trace, run.pair, run.items) if want_artefacts else (),
        colours=run.trace.colours,
        second_place=run.trace.second_place,
    )


def _run_steps(pair: PhotoPair, options: EstimateOptions, trace: Trace) -> Items | Failure:
    """Place, reconstruct, segment, measure, describe."""
    placed = place_views(pair, options, trace)
    if isinstance(placed, Failure):
        return placed
    trace.scale = placed.scale

    reconstructed = reconstruct_scene(placed, pair.others, options, trace)
    if isinstance(reconstructed, Failure):
        return reconstructed
    placed, scene = reconstructed

    with trace.stage("segment"):
        height, width = pair.left.pixels_bgr.shape[:2]
        places = photograph_px(
            scene.rectified,
            scene.points_table,
            trace.left_view,
            is_swapped=trace.is_swapped,
        )
        hints = draw_hints(options.hints, places, (width, height))
        foods = segment_meal(
            scene.rectified,
            scene.disparity,
            scene.points_table,
            scene.is_ignored,
            hints,
            options,
        )
        if isinstance(foods, Failure):
            return foods
        trace.foods = foods

    with trace.stage("volume"):
        measured = measure_foods(foods, placed, scene, pair.left, places, options, trace)
        if isinstance(measured, Failure):
            return measured
        trace.items = measured

    with trace.stage("describe"):
        items = describe_items(measured, scene, pair.left, places, trace)
        return items + missed_hints(options.hints, items)
