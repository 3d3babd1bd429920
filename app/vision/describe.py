"""The last step: measured foods with their looks, and hints at which nothing was measured.

Measured items on the rectified grid -> ItemEstimates with outlines in the left photograph.
"""

from collections.abc import Sequence

from app.vision.looks.traits import traits_of
from app.vision.looks.vcm import describe_rings
from app.vision.model import Float32Array, Hint, ItemEstimate, Photo
from app.vision.solids.measured_item import MeasuredItem
from app.vision.solids.outlines import rings_of
from app.vision.trace import Trace
from app.vision.views.reconstruction import Reconstruction


def describe_items(
    measured: Sequence[MeasuredItem],
    scene: Reconstruction,
    left: Photo,
    places: Float32Array,
    trace: Trace,
) -> tuple[ItemEstimate, ...]:
    """Return the foods with outline, looks and traits. places: see outlines.photograph_px."""
    colour, left_colour = trace.colour_of(0), trace.colour_of(1 if trace.is_swapped else 0)
    items = []
    for item in measured:
        mask, volume = item.region.mask, item.volume
        rings = rings_of(mask, places, is_swapped=trace.is_swapped)
        items.append(
            ItemEstimate(
                rings=rings,
                volume_ml=volume.volume_ml if volume is not None else None,
                volume_interval_ml=volume.interval_ml if volume is not None else None,
                relative_sd=volume.relative_sd if volume is not None else {},
                hint=item.region.hint,
                flags=item.flags,
                traits=traits_of(mask, scene.points_table, scene.rectified.first_bgr, colour),
                vcm=describe_rings(left.pixels_bgr, rings, left_colour),
            )
        )
    return tuple(items)


def missed_hints(hints: Sequence[Hint], items: Sequence[ItemEstimate]) -> tuple[ItemEstimate, ...]:
    """Return an item without outline and volume for each hint where nothing was measured."""
    answered = {item.hint for item in items}
    return tuple(
        ItemEstimate(
            rings=(),
            volume_ml=None,
            volume_interval_ml=None,
            relative_sd={},
            hint=index,
            flags=("not_measurable", "hint_missed"),
        )
        for index, hint in enumerate(hints)
        if hint.has_place and index not in answered
    )
