"""The default method's volume: closed forms of several families fitted to both views, averaged by their evidence.

Regions of the rectified grid, its parallax and points -> measured items with their volume and its doubt. See
docs/decisions/0007-closed-forms-in-both-views.md.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.core.errors import Failure
from app.vision.geometry.masks import dilated, inward_px, window_around
from app.vision.geometry.mesh import Topology, faces_towards
from app.vision.geometry.pictures import LabPicture, grey_of
from app.vision.model import Float32Array, Float64Array, Hint, MaskArray
from app.vision.scene.filled_vessel import FilledVessel
from app.vision.scene.segmentation import Foods, Region, no_food_found
from app.vision.scene.vessel import Vessel
from app.vision.solids.bowl import measure_content
from app.vision.solids.families import families
from app.vision.solids.form_average import Flags, average_forms, likely_fits, log_normal_volume
from app.vision.solids.form_fit import FormFit, fit_form
from app.vision.solids.form_prior import FormPrior, Heights, LikelyForms, form_prior
from app.vision.solids.forms import COARSE, FINE, Form
from app.vision.solids.measured_item import (
    NORMAL_90,
    SCALE_SD,
    MeasuredItem,
    Volume,
    is_low_texture,
    without_clutter,
)
from app.vision.solids.outline_snap import (
    Outline,
    colours_beside,
    outline,
    rings_of_mask,
    snap,
)
from app.vision.solids.prism_starts import begin_prisms
from app.vision.solids.seen import Seen
from app.vision.solids.side_view import SideView
from app.vision.solids.single_starts import (
    USUAL_HEIGHTS,
    single_view_forms,
    upright,
    with_usual_height,
)
from app.vision.solids.surface_match import (
    average_along,
    draw_mask,
    measure_along,
)
from app.vision.tuning import SINGLE_TUNING, TUNING
from app.vision.views.disparity import DisparityMap
from app.vision.views.pinhole_view import PinholeView
from app.vision.views.reconstruction import plane_points
from app.vision.views.rectification import RectifiedPair
from app.vision.views.sight import Sight, sight_of

LAB_MARGIN_PX = 32  # around a food or a form: two rounds of snapping, the band beyond and interpolation reach 24 px
HIDDEN_PX = 5  # around where another food's measured points are seen, which have gaps


@dataclass(frozen=True, slots=True)
class _Food:
    """What fitting needs of one region. lab, hidden_by: of each view; (H, W) foods in front of it.

    grey: of the pair; None of a single view, which stands in its own second one's place in lab. depths: maps beside the
    pair. points: (n, 3) mm; none in a single view. mask_mm2: the mask's area as if it lay on the marker's plane.
    """

    sight: Sight
    seen: Seen
    grey: tuple[Float32Array, Float32Array] | None
    lab: tuple[LabPicture, ...]
    hidden_by: tuple[MaskArray, ...]
    depths: tuple[DisparityMap, ...]
    points: Float64Array
    mask_mm2: float
    support_mm: float
    support_sd_mm: float

    @property
    def is_single(self) -> bool:
        """Return whether it is measured from a single view without a depth map."""
        return self.grey is None and len(self.points) == 0


def measure_shapes(
    foods: Foods,
    pair: RectifiedPair,
    disparity: DisparityMap,
    points_table: Float32Array,
    *,
    pose_sd: float,
    hints: Sequence[Hint] = (),
    others: Sequence[PinholeView] = (),
    depths: Sequence[DisparityMap] = (),
    likely: Sequence[LikelyForms | None] = (),
    sides: Sequence[SideView | None] = (),
) -> list[MeasuredItem] | Failure:
    """Volumes of the foods that can be measured, in the regions' order. Failure "food_not_measured" if there is none.

    points_table: (H, W, 3) mm, NaN. pose_sd: relative, of a volume, see pose_doubt.py. hints: those that the regions'
    indices are of; what they say of a food's form counts as form_prior.py tells. others: further views of the scene.
    depths: maps on the pair's grid and in its scale. likely, sides: of each region, in a single view.
    """
    scene = _scene_of(foods, pair, disparity, points_table, others)
    scene = replace(scene, depths=tuple(depths), sides=tuple(sides))
    measured: list[MeasuredItem | None] = []
    for number, region in enumerate(foods.regions):
        if region.liquid is not None:
            measured.append(
                _of_liquid(region, region.liquid, float(np.hypot(3 * SCALE_SD, pose_sd)))
            )
            continue
        if region.is_unread:
            flags = ("not_measurable",)  # a glass of water: what parallax says there is chance
            measured.append(MeasuredItem(region, np.empty((0, 3)), 0.0, None, flags))
            continue
        food = scene.food(number)
        hint = hints[region.hint] if hints and region.hint is not None else None
        forms = likely[number] if likely else None
        item = (
            None
            if food is None
            else _measured(region, food, scene, pose_sd, form_prior(hint), forms)
        )
        if item is not None or not region.is_by_colour:
            measured.append(item)
    if not measured:
        return no_food_found()
    return without_clutter(measured)


@dataclass(frozen=True, slots=True)
class _Scene:
    foods: Foods
    pair: RectifiedPair
    disparity: DisparityMap
    points_table: Float32Array
    pixel_mm: float
    grey: tuple[Float32Array, Float32Array] | None
    lab: tuple[LabPicture, ...]
    others: tuple[PinholeView, ...]
    depths: tuple[DisparityMap, ...] = ()
    sides: tuple[SideView | None, ...] = ()

    def food(self, number: int) -> _Food | None:
        mask = self.foods.regions[number].mask
        window = window_around(mask, TUNING.margin_px)
        plane_xy_mm = plane_points(self.pair, window)[..., :2]
        sight = sight_of(self.pair, self.foods.table, plane_xy_mm, window)
        rings = rings_of_mask(mask)
        if not rings:
            return None
        in_pair = self._in_front(number)
        lab = self.lab[0].within(window_around(mask, LAB_MARGIN_PX))
        line = _without(snap(lab, rings, TUNING.snap_px), in_pair[0])
        inward = inward_px(mask)
        seen_parallax = self.disparity.parallax_px[window]
        measured = np.argwhere(
            np.isfinite(seen_parallax) & (inward[window] > self.disparity.reach_px[window])
        )
        if len(measured) == 0 and self.pair.second_bgr is not None:
            return None
        parallax = seen_parallax[measured[:, 0], measured[:, 1]].astype(np.float64)
        pixels = measured[:, ::-1] + [window[1].start, window[0].start]
        points = sight.points(pixels.astype(np.float64), parallax)
        support_mm, support_sd_mm = self._support(
            number, points if len(points) else plane_xy_mm[mask[window]]
        )
        seen = Seen(sight, mask, inward, (line, None), self.disparity, others=self.others)
        if self.grey is None and len(points) == 0:
            side = self.sides[number] if self.sides else None
            middle = np.append(np.median(plane_xy_mm[mask[window]], axis=0), support_mm)
            side = None if side is None else replace(side, middle_mm=middle.astype(np.float64))
            seen = replace(seen, outline_sd_px=SINGLE_TUNING.outline_sd_px, side=side)
        hidden_by = *in_pair, *(self._in_front_of(number, points, view) for view in self.others)
        mask_mm2 = float(np.count_nonzero(mask)) * self.pixel_mm**2
        return _Food(
            sight,
            seen,
            self.grey,
            self.lab,
            hidden_by,
            self.depths,
            points,
            mask_mm2,
            support_mm,
            support_sd_mm,
        )

    def _support(self, number: int, points: Float64Array | Float32Array) -> tuple[float, float]:
        """Height over the table of what the food rests on, and its sd, mm. points: (n, 2 or 3) of the food, mm."""
        support = self.foods.regions[number].support
        if support is None:
            return TUNING.support_unknown_mm, TUNING.support_unknown_sd_mm
        middle = np.median(points[:, :2].astype(np.float64), axis=0)
        table_mm = float(self.foods.table.height_mm(middle))
        return support.height_mm - table_mm, max(support.sd_mm, TUNING.least_support_sd_mm)

    def _in_front(self, number: int) -> tuple[MaskArray, MaskArray]:
        """(H, W) in either view: foods that touch this one in the first view and lie nearer to the camera there."""
        mask = self.foods.regions[number].mask
        first, second = np.zeros(mask.shape, np.bool_), np.zeros(mask.shape, np.bool_)
        reach = 2 * TUNING.touching_px + 1
        window = window_around(mask, reach)
        points, own_mask = self.points_table[window], mask[window]
        beside = dilated(own_mask, reach)
        for other, region in enumerate(self.foods.regions):
            shared = region.mask[window] & beside
            if other == number or not shared.any():
                continue
            own = own_mask & dilated(region.mask[window], reach)
            if (
                self._distance_mm(points[shared])
                < self._distance_mm(points[own]) + TUNING.in_front_mm
            ):
                first |= region.mask
        if not first.any():
            return first, second
        rows, columns = np.nonzero(first & np.isfinite(self.disparity.parallax_px))
        moved = np.rint(columns - self.disparity.parallax_px[rows, columns]).astype(np.int64)
        inside = (moved >= 0) & (moved < mask.shape[1])
        second[rows[inside], moved[inside]] = True
        return first, dilated(second, HIDDEN_PX)

    def _in_front_of(self, number: int, points: Float64Array, view: PinholeView) -> MaskArray:
        """(H, W) of another view: foods that lie nearer to its camera than this one's points."""
        height, width = view.picture_bgr.shape[:2]
        picture = np.zeros((height, width), np.bool_)
        own_mm = np.median(np.linalg.norm(points - view.centre_mm, axis=1))
        for other, region in enumerate(self.foods.regions):
            theirs = self.points_table[region.mask].astype(np.float64)
            theirs = theirs[np.isfinite(theirs[:, 2])]
            if other == number or len(theirs) == 0:
                continue
            if np.median(np.linalg.norm(theirs - view.centre_mm, axis=1)) < own_mm:
                column, row = np.rint(view.project(theirs)).astype(np.int64).T
                inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
                picture[row[inside], column[inside]] = True
        return dilated(picture, HIDDEN_PX)

    def _distance_mm(self, points: Float32Array) -> float:
        points = points[np.isfinite(points[:, 2])]
        if len(points) == 0:
            return np.inf
        return float(np.median(np.linalg.norm(points - self.pair.first_centre_mm, axis=1)))


def _scene_of(
    foods: Foods,
    pair: RectifiedPair,
    disparity: DisparityMap,
    points_table: Float32Array,
    others: Sequence[PinholeView],
) -> _Scene:
    is_single = pair.second_bgr is None
    first_bgr, second_bgr = (pair.first_bgr, pair.first_bgr) if is_single else pair.both_bgr
    grey = [grey_of(image).astype(np.float32) for image in (first_bgr, second_bgr)]
    lab = tuple(
        LabPicture(image)
        for image in (first_bgr, second_bgr, *(view.picture_bgr for view in others))
    )
    of_pair = None if is_single else (grey[0], grey[1])
    return _Scene(foods, pair, disparity, points_table, pair.pixel_mm, of_pair, lab, tuple(others))


def _without(line: Outline, hidden_by: MaskArray) -> Outline:
    """The outline without weight where another food in front of this one ends it."""
    return replace(line, weights=np.where(_is_hidden(line, hidden_by), 0.0, line.weights))


def _is_hidden(line: Outline, hidden_by: MaskArray) -> MaskArray:
    """Return (n,) where foods in front, (H, W), end an outline."""
    beyond = np.rint(line.points_px + TUNING.beyond_px * line.normals).astype(np.int64)
    height, width = hidden_by.shape
    column, row = np.clip(beyond[:, 0], 0, width - 1), np.clip(beyond[:, 1], 0, height - 1)
    return hidden_by[row, column]


def _fit_families(
    food: _Food, prior: FormPrior | None, heights: Heights
) -> tuple[list[FormFit], Seen]:
    """Fits, those of the best evidence first, and what they were fitted to: all coarsely, the better ones finely.

    Of the form that is known beforehand, the best one is among these. heights: see single_view_forms.
    """
    camera = food.sight.cameras_mm[0]
    forms = families(food.points, food.mask_mm2, food.support_mm, food.support_sd_mm, camera)
    if len(food.points) == 0:
        forms = single_view_forms(
            food.sight, food.seen.mask, food.support_mm, food.support_sd_mm, heights
        )
        if food.seen.side is not None:
            forms = [upright(form) for form in forms]
    elif forms:
        height_mm = float(np.quantile(food.points[:, 2], TUNING.top_quantile)) - food.support_mm
        forms += begin_prisms(
            food.sight, food.seen.mask, height_mm, food.support_mm, food.support_sd_mm
        )
    hinted_families = prior.families if prior is not None else ()
    plain = [replace(with_usual_height(form, heights), has_displacement=False) for form in forms]
    ranked = _coarse_fits(food, plain, hinted_families)
    kept = SINGLE_TUNING.kept if food.is_single else TUNING.kept
    of_form = [fit for fit in ranked[kept:] if fit.form.name in hinted_families]
    nearest = ranked[:kept] + of_form[:1]
    if food.is_single:
        return _refitted(food.seen, nearest), food.seen
    return _settled(food, nearest, hinted_families)


def _coarse_fits(food: _Food, forms: Sequence[Form], hinted: Collection[str]) -> list[FormFit]:
    """Return the coarse fits, best first: a few rounds of all, then to their end of the nearest and of hinted families.

    In a single view all are fitted to their end, since one outline hardly tells them apart.
    """
    begun = [fit_form(form, food.seen, COARSE, most_rounds=TUNING.first_rounds) for form in forms]
    ranked = sorted((fit for fit in begun if fit is not None), key=lambda fit: fit.cost)
    near = [
        fit
        for number, fit in enumerate(ranked)
        if number < TUNING.kept_coarse or fit.form.name in hinted or food.is_single
    ]
    ended = [fit_form(fit.form, food.seen, COARSE, fit.unknowns, pose=fit.at.pose) for fit in near]
    return sorted((fit for fit in ended if fit is not None), key=lambda fit: fit.cost)


def _settled(
    food: _Food, fits: list[FormFit], hinted: Collection[str]
) -> tuple[list[FormFit], Seen]:
    """All fitted along the best one, again while its volume changes: parallax along a wrong form is wrong as well."""
    seen = food.seen
    for _ in range(TUNING.max_passes):
        if not fits:
            break
        before_ml, seen = fits[0].volume_ml, _seen_along(food, fits[0])
        fits = likely_fits(_refitted(seen, fits), hinted)
        if fits and abs(np.log(fits[0].volume_ml / before_ml)) < TUNING.settled:
            break
    return fits, seen


def _refitted(seen: Seen, fits: Sequence[FormFit]) -> list[FormFit]:
    """All fitted finely from where they are, the best first, but for those whose volume that leaves undetermined."""
    refitted = []
    for before in fits:
        form = replace(before.form, has_displacement=True)
        start = np.zeros(len(form.start))
        start[: len(before.unknowns)] = before.unknowns
        fit = fit_form(form, seen, FINE, start, pose=before.at.pose)
        if fit is not None and fit.is_determined:
            refitted.append(fit)
    return sorted(refitted, key=lambda fit: fit.evidence)


def _seen_along(food: _Food, near: FormFit) -> Seen:
    """The food with its parallax along a form near it, and its outline in the other views around that form's.

    A single view shows nothing more along any form.
    """
    if food.grey is None:
        return food.seen
    vertices, mesh = near.form.vertices(near.unknowns, FINE), near.form.topology(FINE)
    covered = _covered(food, vertices, mesh)
    surface = measure_along(food.sight, food.grey, (food.seen.mask, covered[0]), vertices, mesh)
    by_maps = (
        average_along(food.sight, each, food.seen.inward_px, vertices, mesh) for each in food.depths
    )
    outlines = (_outline_in(food, view, mask) for view, mask in enumerate(covered, start=1))
    return replace(
        food.seen,
        surface=surface,
        by_maps=tuple(each for each in by_maps if each is not None),
        outlines=(food.seen.outlines[0], *outlines),
    )


def _covered(food: _Food, vertices: Float64Array, mesh: Topology) -> list[MaskArray]:
    """(H, W) what the form covers in the second view and in each of the others."""
    sight = food.sight
    seen_by = [(sight.in_view(*sight.project(vertices), 1), sight.cameras_mm[1])]
    seen_by += [(view.project(vertices), view.centre_mm) for view in food.seen.others]
    return [
        draw_mask(pixels, mesh.faces[faces_towards(vertices, mesh.faces, camera)], lab.shape)
        for (pixels, camera), lab in zip(seen_by, food.lab[1:], strict=True)
    ]


def _outline_in(food: _Food, view: int, covered: MaskArray) -> Outline | None:
    """The food's outline in a view, sought around the form's, by the colours beside the first view's.

    view: from 1, the second. covered: (H, W) by the form.
    """
    first = food.seen.outlines[0]
    rings = rings_of_mask(covered)
    if not rings or first is None:
        return None
    inside, outside = colours_beside(
        food.lab[0].within(window_around(food.seen.mask, LAB_MARGIN_PX)), first
    )
    lab = food.lab[view].within(window_around(covered, LAB_MARGIN_PX))
    shift = first.points_px.mean(axis=0) - outline(rings, np.empty(0)).points_px.mean(axis=0)

    def reference(points: Float64Array) -> tuple[Float64Array, Float64Array]:
        _, nearest = first.nearest.query(points + shift)
        return inside[nearest], outside[nearest]

    line = _without(snap(lab, rings, TUNING.snap_second_px, reference), food.hidden_by[view])
    return replace(line, weights=TUNING.second_weight * line.weights)


def _measured(
    region: Region,
    food: _Food,
    scene: _Scene,
    pose_sd: float,
    prior: FormPrior | None,
    likely: LikelyForms | None,
) -> MeasuredItem | None:
    """One food: what fills a bowl by the bowl, everything else by its form."""
    pair_sd = float(np.hypot(3 * SCALE_SD, pose_sd))
    result = _of_bowl(region, food, scene, pair_sd) if region.vessel is not None else None
    seen_again = None
    if result is None:
        likely = likely if food.is_single else None
        heights = USUAL_HEIGHTS if likely is None else likely.heights(USUAL_HEIGHTS)
        fits, seen = _fit_families(food, prior, heights)
        seen_again = _seen_again(food, seen)
        if not fits or (region.is_by_colour and not _stands(fits[0], seen_again)):
            return None
        result = average_forms(fits, pair_sd, prior, likely, is_single=food.is_single)
    volume, support_mm, flags = result
    if not food.is_single and is_low_texture(np.isfinite(scene.disparity.parallax_px), region.mask):
        flags = (*flags, "low_texture")
    if food.seen.side is not None:
        flags = (*flags, "view_from_side")
    return MeasuredItem(region, food.points, support_mm, volume, flags, food.sight, seen_again)


def _seen_again(food: _Food, seen: Seen) -> float | None:
    """Return how clear the food's outline is in the second view, where the form puts it, over how clear in the first.

    Where another food hides it, it tells nothing. None without a second view, or where a depth map shows the food.
    """
    if food.grey is None or seen.by_maps:
        return None
    first, second = (
        None if line is None else line.weights[~_is_hidden(line, hidden_by)]
        for line, hidden_by in zip(seen.outlines, food.hidden_by, strict=False)
    )
    if first is None or second is None or not first.any() or len(second) == 0:
        return None
    return float(second.mean() / (TUNING.second_weight * first.mean()))


def _stands(fit: FormFit, seen_again: float | None) -> bool:
    """Return whether both views show a form, and surely of a food's height: no napkin, telephone or shadow."""
    high_mm = float(np.ptp(fit.form.vertices(fit.unknowns, FINE)[:, 2]))
    least_mm = high_mm * (1.0 - NORMAL_90 * fit.volume_sd_ml / fit.volume_ml)
    is_seen = seen_again is not None and seen_again > TUNING.sure_seen_again
    return is_seen and least_mm > TUNING.least_height_mm


def _of_bowl(
    region: Region, food: _Food, scene: _Scene, pair_sd: float
) -> tuple[Volume | None, float, Flags] | None:
    """What fills the bowl that holds the food, without a volume where that would be a guess; None for one beside it."""
    vessel = region.vessel
    if vessel is None:
        return None
    table_mm = float(scene.foods.table.height_mm(vessel.centre_mm))
    content = measure_content(food.points, vessel, table_mm, food.support_mm, food.support_sd_mm)
    if content is None and _is_beside(food.points, vessel):
        return None
    is_known = content is not None and content.sd_ml < TUNING.unknown_inside_sd * content.volume_ml
    # with no wall in view, what is like bowls alone would speak
    is_known &= len(vessel.wall_mm) > 0
    flags = ("inside_guessed",) if is_known else ("not_measurable",)
    if content is None or not is_known:
        return None, food.support_mm, flags
    rest = food.points - [0.0, 0.0, food.support_mm]
    item_sd = content.sd_ml / content.volume_ml
    volume = log_normal_volume(
        content.volume_ml, pair_sd, item_sd, content.slices, vessel.centre_mm, rest, content.shape
    )
    return volume, food.support_mm, flags


def _of_liquid(region: Region, vessel: FilledVessel, pair_sd: float) -> MeasuredItem:
    """A liquid as its vessel measured it, without a volume where that would be a guess."""
    liquid, points = vessel.liquid, vessel.surface_points()
    volume = None
    if liquid.is_measurable:
        item_sd = liquid.sd_ml / liquid.volume_ml
        middle, rest = vessel.rim.centre_mm, points - [0.0, 0.0, liquid.floor_mm]
        volume = log_normal_volume(
            liquid.volume_ml, pair_sd, item_sd, liquid.slices, middle, rest, liquid.shape
        )
    return MeasuredItem(region, points, liquid.floor_mm, volume, vessel.flags)


def _is_beside(points_table: Float64Array, vessel: Vessel) -> bool:
    """Whether most of a food lies outside the bowl's rim."""
    return bool(
        np.median(np.linalg.norm(points_table[:, :2] - vessel.centre_mm, axis=1))
        >= vessel.radius_mm
    )
