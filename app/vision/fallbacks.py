"""Which inputs of a meal are believed, and what is measured instead where they fail.

Photographs and options in -> the run that counts. What gives the scale is chosen first: a rig, a
known object, the marker, poses, a depth map. The left photograph is paired with its best partner;
the next one follows while a run fails. Then come the left photograph alone by its depth map, the poses, and the
left photograph alone by the marker.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace

from app.core.errors import Failure
from app.vision.model import EstimateOptions, ItemEstimate, PhotoPair
from app.vision.solids.measured_item import MeasuredItem
from app.vision.stages import Stages
from app.vision.trace import Trace
from app.vision.views.features import too_few_matches
from app.vision.views.other_views import stereo_partners
from app.vision.views.placement import (
    Placement,
    views_by_depth,
    views_by_marker,
    views_by_object,
    views_by_poses,
    views_by_rig,
)

Items = tuple[ItemEstimate, ...]
Steps = Callable[[PhotoPair, EstimateOptions, Trace], Items | Failure]

# Without these another source may give the scale, or the left photograph is measured alone.
# Of another board or a poor photograph, the photographer should hear.
MARKER_UNSEEN = frozenset({"marker_not_found", "marker_covered"})
UNMEASURED = frozenset({"no_food_found", "food_not_measured"})
# Failures of a pair after which its left photograph alone may be measured, if it has a depth map.
PAIR_UNUSABLE = frozenset(
    {
        "baseline_too_small",
        "baseline_too_large",
        "too_few_matches",
        "scene_moved",
        "food_not_measured",
    }
)


@dataclass(frozen=True, slots=True)
class Run:
    """One attempt: the photographs, how far it came, and the items or why there are none."""

    pair: PhotoPair
    trace: Trace
    outcome: Items | Failure

    @property
    def items(self) -> Items:
        """The foods; none after a failure."""
        return () if isinstance(self.outcome, Failure) else self.outcome

    @property
    def failure(self) -> Failure | None:
        """Why nothing was measured."""
        return self.outcome if isinstance(self.outcome, Failure) else None


def run_with_fallbacks(
    pair: PhotoPair, options: EstimateOptions, stage: Stages, steps: Steps
) -> Run:
    """Run the steps with the best partner of the left photograph; while that fails, with the next.

    A run by the marker alone counts only if no partner has matches. If all fail, fallbacks are
    tried. Unless one of them succeeds, the failure is that of the pair as it was sent.
    """
    pairs = [pair]
    if pair.others and options.marker is not None:
        with stage("marker"):
            pairs = stereo_partners(pair, options.marker)
    run_by_marker_alone: Run | None = None
    for partners in pairs:
        trace = Trace(stage, second_place=_place_of_right(partners, pair))
        run = _run(partners, options, trace, steps)
        if run.failure is None and not trace.is_by_marker_alone:
            return run
        if run.failure is None:
            run_by_marker_alone = run_by_marker_alone or run
        if partners.right is pair.right:
            run_as_sent = run
    if run_by_marker_alone is not None:
        return run_by_marker_alone
    sent_trace = run_as_sent.trace
    for fallback_pair, fallback_options in _fallbacks(run_as_sent, pair, options):
        trace = Trace(stage, markers=sent_trace.markers, colours=sent_trace.colours)
        run = _run(fallback_pair, fallback_options, trace, steps)
        if run.failure is None:
            return run
    return run_as_sent


def place_views(pair: PhotoPair, options: EstimateOptions, trace: Trace) -> Placement | Failure:
    """Return the views by rig, known object, marker, poses or depth map, the first that is given.

    A metric depth map also gives the scale where the marker is not seen. Raises ValueError for
    options without any.
    """
    depth = pair.left.depth
    if options.rig is not None:
        return views_by_rig(pair, options.rig, options, trace)
    if options.known is not None:
        return views_by_object(pair, options.known, options, trace)
    if options.marker is not None:
        # Poses are better than one photograph by the marker; a depth map with it is better still.
        has_better = options.poses is not None and depth is None
        may_be_alone = options.method == "shape" and not has_better
        alone_after: Collection[str] = MARKER_UNSEEN if may_be_alone else ()
        placed = views_by_marker(pair, options.marker, options, trace, left_alone_after=alone_after)
        is_unseen = isinstance(placed, Failure) and placed.code in MARKER_UNSEEN
        if depth is None or depth.is_relative or options.method != "shape" or not is_unseen:
            return placed
    elif options.poses is not None and pair.right is not None:
        return views_by_poses(pair, options.poses, options, trace)
    if depth is None:
        raise ValueError("Options need a marker or a rig: one of them gives the scale.")
    if depth.is_relative:
        return Failure(
            "scale_missing",
            "The depth map inside the photograph's file is only relative, and nothing else gives "
            "the scale.",
            "Place the marker beside the plate, or send both photographs.",
        )
    return views_by_depth(pair.left, depth, options, trace)


def _fallbacks(
    run_as_sent: Run, pair: PhotoPair, options: EstimateOptions
) -> Iterator[tuple[PhotoPair, EstimateOptions]]:
    """Yield what to measure instead: the left photograph alone, or the pair by its poses.

    The former by its depth map where the pair is unusable, the latter where no marker is seen. If
    the poses do not help, and the left photograph shows the marker, that one is measured alone.
    """
    failure = run_as_sent.failure
    if failure is None:
        return
    if failure.code in PAIR_UNUSABLE and _may_be_measured_alone(pair, options):
        yield PhotoPair(pair.left), options
    if failure.code in MARKER_UNSEEN and options.poses and pair.right is not None:
        yield pair, replace(options, marker=None)
        if run_as_sent.trace.markers[0] is not None and options.method == "shape":
            yield PhotoPair(pair.left), options


def _run(pair: PhotoPair, options: EstimateOptions, trace: Trace, steps: Steps) -> Run:
    """Run the steps; what the marker alone placed has to be confirmed by a food at rest."""
    outcome = steps(pair, options, trace)
    is_doubtful = _may_be_measured_alone(pair, options) or not _is_confirmed(outcome, trace.items)
    is_doubtful |= options.method == "paper-strict"  # whose F the marker's plane alone leaves open
    if trace.matches is not None and trace.is_by_marker_alone and is_doubtful:
        outcome = too_few_matches(trace.matches.beside_board)
        trace.items, trace.printed = [], None
    return Run(pair, trace, outcome)


def _place_of_right(partners: PhotoPair, pair: PhotoPair) -> int:
    """Return which photograph as sent stands for the right one, counted from the left one's 0."""
    photos = [pair.right, *pair.others]
    return next(place for place, photo in enumerate(photos, 1) if photo is partners.right)


def _may_be_measured_alone(pair: PhotoPair, options: EstimateOptions) -> bool:
    """Return whether the left photograph has a depth map and a marker: it needs no other one."""
    return pair.left.depth is not None and options.marker is not None and options.method == "shape"


def _is_confirmed(outcome: Items | Failure, measured: Sequence[MeasuredItem]) -> bool:
    """Return whether a food that both show in one place tells that they are of one scene at rest.

    A failure for another reason stays what it is.
    """
    if isinstance(outcome, Failure):
        return outcome.code not in UNMEASURED
    return any(item.shows_rest for item in measured)
