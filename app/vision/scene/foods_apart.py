"""Tells touching foods apart: cuts a mask in two wherever colour, outline and heights together say that it is two.

A mask -> candidate cuts (clusters of colour, necks of the outline, separate tops), each moved onto the image's edges
and judged: by the difference of colour across the cut, by the image's edges along it, by notches of the outline at its
ends, by its length against the parts' width, and by a valley or a step in distance along it. One food of two tones has
no notch; one bent food has neither contrast nor valley; no convex food hides a part of itself, and so has no step.
"""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from app.vision.geometry.masks import (
    components,
    dilated,
    distance_px,
    filled,
    inward_px,
    labelled,
    largest_part,
    resized,
    solidity,
)
from app.vision.geometry.pictures import lab_bytes
from app.vision.model import Float32Array, MaskArray
from app.vision.scene.colour_bins import (
    colour_bins,
    colour_evidence,
    colour_histogram,
    contrast_features,
)
from app.vision.scene.min_cut import cut_in_two
from app.vision.scene.scene import Scene
from app.vision.scene.upright_sides import flat_top

MIN_PART_MM2 = 200.0  # seen by the camera: smaller than a cherry tomato
MIN_PART_SHARE = 0.05  # of the mask that is cut
COLOUR_WEIGHTS = (0.6, 1.5, 1.5)  # of Lab: light varies over one food more than hue does
CLUSTERS = 3
NECK_LEVELS = (0.85, 0.75, 0.65, 0.55, 0.45, 0.35)  # of the greatest depth within the outline
TOP_LEVELS = (0.3, 0.375, 0.45, 0.525, 0.6, 0.675, 0.75, 0.825, 0.9)  # of the height
MIN_MARKER_MM2 = 15.0  # of a neck's side, of a top
BESIDE_MM = (2.0, 9.0)  # from the cut, where the colours of its two sides are compared
NOTCH_RADIUS_MM = 7.0
COLOUR_NOISE = 3.0
SHADE_WEIGHT = 0.5  # of a difference of light alone, which the two faces of one food show as well
STEP_AT_MM = (4.0, 8.0)  # from the cut, where distances are taken that are continued to it
STEP_MM = (5.0, 25.0)  # between what is in front and behind: no step, and one that counts in full
STEP_WEIGHT = 1.0
# of the disc around a corner of the outline, beyond the half that a smooth outline fills
FULL_NOTCH = 0.25
SHORT_CUT = 0.5  # of the narrower part's width: so short a cut has its notches at one place
# share of its convex hull that the outline of one solid fills, and that of two
CONVEX = (0.98, 0.95)
WHOLE_WEIGHT = 0.2  # against a cut of an outline that is convex as a whole
# the same of a part: a solid's face, and a food that another one partly hides
BITTEN = (0.92, 0.86)
CONVEX_SHARE = 0.94  # of its convex hull that the outline of one block fills
CREASE_WEIGHT = 0.4
THRESHOLD = 1.35  # of the judgement below; see its comment
MAX_TRIALS = 2
TRIAL_PX = 4000  # of a mask, to which it is reduced while cuts are tried
PLACE_MM = 8.0  # within which the cut keeps near its proposal
PLACE_NATS = 1.5


def tell_apart(food: MaskArray, scene: Scene, floor_mm: float = 0.0) -> list[MaskArray]:
    """(h, w) masks, one per food, of the scene's grid; they do not overlap. floor_mm: of the support over the table."""
    foods: list[MaskArray] = []
    size = max(3, round(2.5 / scene.pixel_mm) | 1)
    labels, stats, _ = labelled(_opened(food, size))
    for label in range(1, len(stats)):
        x, y, width, height, area = (int(value) for value in stats[label])
        if area * scene.pixel_mm**2 < MIN_PART_MM2:
            continue
        window = (slice(max(0, y - 4), y + height + 4), slice(max(0, x - 4), x + width + 4))
        lab = lab_bytes(scene.image_bgr[window])
        piece = _Piece(lab, scene.height_mm[window], scene.distance_mm(window), scene.pixel_mm)
        waiting = [labels[window] == label]
        while waiting:
            mask = waiting.pop()
            is_block = _is_one_block(_framed(mask, window, food.shape), scene, floor_mm)
            parts = None if is_block else piece.best_cut(mask)
            if parts is None:
                foods.append(_framed(mask, window, food.shape))
            else:
                waiting += parts
    return foods


def divide(mask: MaskArray, seeds: Sequence[MaskArray], scene: Scene) -> list[MaskArray]:
    """The mask's share of each seed (h, w), the cuts between neighbours lying on the image's edges."""
    lab = lab_bytes(scene.image_bgr)
    piece = _Piece(lab, scene.height_mm, scene.distance_mm(), scene.pixel_mm)
    nearest = np.stack([distance_px(seed) for seed in seeds]).argmin(axis=0)
    shares = [mask & (nearest == place) for place in range(len(seeds))]
    for first in range(len(seeds)):
        for second in range(first + 1, len(seeds)):
            if shares[first].any() and shares[second].any():
                shares[first], shares[second] = piece.on_edges(
                    shares[first], shares[second], seeds[first], seeds[second]
                )
    return shares


class _Piece:
    """A window of the scene in which one mask is cut. distance_mm: (h, w) from the camera."""

    def __init__(
        self, lab: Float32Array, height_mm: Float32Array, distance_mm: Float32Array, pixel_mm: float
    ) -> None:
        self._plain_lab = lab
        self._lab = lab * np.array(COLOUR_WEIGHTS, np.float32)
        self._edges = _edge_strength(self._lab)
        self._height_mm = height_mm
        self._distance_mm = distance_mm
        self._pixel_mm = pixel_mm
        self._bins = colour_bins(lab)
        self._features = contrast_features(lab)

    def best_cut(self, mask: MaskArray) -> list[MaskArray] | None:
        """The two parts of the most convincing cut, or None if none convinces."""
        scale = float(np.sqrt(TRIAL_PX / max(1, int(np.count_nonzero(mask)))))
        if scale >= 1.0:
            tried = self.scored_cuts(mask)
            return tried[0][1] if tried and tried[0][0] > THRESHOLD else None
        size = (round(mask.shape[1] * scale), round(mask.shape[0] * scale))
        lab = np.asarray(
            cv2.resize(self._plain_lab, size, interpolation=cv2.INTER_AREA), np.float32
        )
        height, distance = (
            np.asarray(cv2.resize(field, size, interpolation=cv2.INTER_NEAREST), np.float32)
            for field in (self._height_mm, self._distance_mm)
        )
        best: tuple[float, list[MaskArray]] | None = None
        reduced = _Piece(lab, height, distance, self._pixel_mm / scale)
        for hope, halves in reduced.scored_cuts(largest_part(resized(mask, size)))[:MAX_TRIALS]:
            if hope < THRESHOLD:
                break
            sides = [
                distance_px(cv2.resize(half.astype(np.uint8), mask.shape[::-1]) > 0)
                for half in halves
            ]
            nearer = mask & (sides[0] <= sides[1])
            parts = self.on_edges(nearer, mask & ~nearer)
            score = self._judge(*parts)
            if score > THRESHOLD and (best is None or score > best[0]):
                best = score, list(parts)
        return best[1] if best else None

    def scored_cuts(self, mask: MaskArray) -> list[tuple[float, list[MaskArray]]]:
        """All proposed cuts, on the edges, each with its judgement, best first."""
        least_px = max(MIN_PART_MM2 / self._pixel_mm**2, MIN_PART_SHARE * np.count_nonzero(mask))
        tried: list[MaskArray] = []
        scored = []
        for proposal in self._proposals(mask, least_px):
            if any(_is_same_cut(proposal, other, mask) for other in tried):
                continue
            tried.append(proposal)
            first, second = self.on_edges(proposal, mask & ~proposal)
            if min(np.count_nonzero(first), np.count_nonzero(second)) >= least_px:
                scored.append((self._judge(first, second), [first, second]))
        return sorted(scored, key=lambda cut: -cut[0])

    def on_edges(
        self,
        first_part: MaskArray,
        second_part: MaskArray,
        seed_one: MaskArray | None = None,
        seed_two: MaskArray | None = None,
    ) -> tuple[MaskArray, MaskArray]:
        """The same two parts with the border moved onto the edges near it and to where their colours part."""
        mask = first_part | second_part
        always, never = (
            _inner_half(part) if seed is None else seed & mask
            for part, seed in ((first_part, seed_one), (second_part, seed_two))
        )
        first, second = (colour_histogram([self._bins], part) for part in (first_part, second_part))
        ratio = colour_evidence(first, second)[self._bins]
        place = (distance_px(second_part) - distance_px(first_part)) * self._pixel_mm / PLACE_MM
        ratio += np.clip(place, -PLACE_NATS, PLACE_NATS)
        cut = cut_in_two(
            np.where(mask, ratio, 0.0).astype(np.float32), self._features, never, always
        )
        rest = largest_part(mask & ~largest_part(mask & cut))
        return largest_part(mask & ~rest), rest

    def _proposals(self, mask: MaskArray, least_px: float) -> Iterator[MaskArray]:
        yield from self._by_colour(mask, least_px)
        depth = inward_px(filled(mask))
        yield from self._by_level(mask, depth / depth.max(), NECK_LEVELS, least_px)
        height = cv2.medianBlur(np.nan_to_num(self._height_mm, nan=0.0), 5) * mask
        top = float(np.quantile(height[mask], 0.98))
        if top > 0:
            share = np.asarray(height / top, np.float32)
            yield from self._by_level(mask, share, TOP_LEVELS, least_px)

    def _by_colour(self, mask: MaskArray, least_px: float) -> Iterator[MaskArray]:
        smooth = cv2.GaussianBlur(self._lab, (0, 0), 2.0)[mask]
        some = np.ascontiguousarray(smooth[:: max(1, len(smooth) // 1500)])
        size = max(3, round(4 / self._pixel_mm) | 1)
        if len(some) < CLUSTERS:
            return
        cv2.setRNGSeed(0)
        _, _, centres = cv2.kmeans(
            some, CLUSTERS, np.empty(0, np.int32), (3, 20, 0.5), 2, cv2.KMEANS_PP_CENTERS
        )
        cluster_of = np.full(mask.shape, -1, np.int64)
        cluster_of[mask] = ((smooth[:, None] - centres[None]) ** 2).sum(axis=-1).argmin(axis=1)
        for cluster in range(CLUSTERS):
            labels, stats, _ = labelled(_opened(cluster_of == cluster, size))
            for label in range(1, len(stats)):
                if stats[label, cv2.CC_STAT_AREA] >= least_px:
                    part = filled(labels == label) & mask
                    if np.count_nonzero(mask & ~part) >= least_px:
                        yield part

    def _by_level(
        self,
        mask: MaskArray,
        field: Float32Array,
        levels: Sequence[float],
        least_px: float,
    ) -> Iterator[MaskArray]:
        """Each part that stands alone above some level of the field, with what lies nearest to it."""
        most = 1
        for level in levels:
            labels, stats, _ = labelled((field > level) & mask)
            kept = [
                k
                for k in range(1, len(stats))
                if stats[k, cv2.CC_STAT_AREA] * self._pixel_mm**2 >= MIN_MARKER_MM2
            ]
            if len(kept) <= most:
                continue
            most = len(kept)
            nearest = np.stack([distance_px(labels == label) for label in kept]).argmin(axis=0)
            for place in range(len(kept)):
                part = mask & (nearest == place)
                if least_px <= np.count_nonzero(part) <= np.count_nonzero(mask) - least_px:
                    yield part

    def _judge(self, first: MaskArray, second: MaskArray) -> float:
        """How well two parts stand for two foods: about 2 or more where they do, below 1 where they do not."""
        border = first & dilated(second, 3)
        if not border.any():
            return 0.0
        widths = [2 * float(inward_px(filled(part)).max()) for part in (first, second)]
        # a slanted line has fewer pixels than its length
        length = 1.1 * np.count_nonzero(border) / min(widths)
        near_mm = distance_px(border) * self._pixel_mm
        beside = (near_mm > BESIDE_MM[0]) & (near_mm < BESIDE_MM[1])
        if min(np.count_nonzero(first & beside), np.count_nonzero(second & beside)) < 10:
            return 0.0
        medians, spreads = [], []
        for part in (first, second):
            colours = self._lab[part & beside]
            medians.append(np.median(colours, axis=0))
            spreads.append(1.48 * np.median(np.abs(colours - medians[-1]), axis=0))
        spread = np.sqrt(0.5 * (spreads[0] ** 2 + spreads[1] ** 2)) + COLOUR_NOISE
        contrast = _contrast(medians[0], medians[1], spread)
        dented = max(
            _dented(first | second, CONVEX),
            *(_dented(filled(part), BITTEN) for part in (first, second)),
        )
        notch = FULL_NOTCH if length < SHORT_CUT else dented * self._notch(first | second, border)
        valley = dented * self._valley(first, second, border)
        crease = CREASE_WEIGHT * float(
            np.clip(self._crease(first | second, border) - 0.7, -0.5, 0.8)
        )
        # however clear a border is, looks alone make no two foods
        look = min(contrast / 3 + crease, 4 / 3)
        # a loaf's crust and crumb part as clearly
        whole = WHOLE_WEIGHT * (1.0 - _dented(first | second, CONVEX))
        score = (
            look
            + 6.0 * float(np.clip(notch, 0.0, FULL_NOTCH))
            - 0.35 * length
            + 0.5 * valley
            - whole
        )
        if score > THRESHOLD:  # a step counts where the look does not convince
            return score
        return score + STEP_WEIGHT * dented * self._step(first, second, border)

    def _notch(self, mask: MaskArray, border: MaskArray) -> float:
        """How far the outline is dented where the border meets it: share of a disc there beyond one half."""
        radius = max(6, round(NOTCH_RADIUS_MM / self._pixel_mm))
        disc = cv2.getStructuringElement(
            cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)
        ).astype(np.float32)
        padded = np.pad(mask, radius + 2)
        share = cv2.filter2D(
            padded.astype(np.uint8), cv2.CV_32F, disc / disc.sum(), borderType=cv2.BORDER_CONSTANT
        )
        near_outline = inward_px(padded, 3) <= 2.5
        ends = np.pad(border, radius + 2) & near_outline
        dents = sorted(
            (float(share[ends & part].max()) - 0.5 for part in components(dilated(ends, 5))),
            reverse=True,
        )
        return sum(dents[:2]) / 2 if len(dents) >= 2 else 0.0

    def _crease(self, mask: MaskArray, border: MaskArray) -> float:
        """How strong the image's edges along the border are against those elsewhere: a ratio, 0 if unknown."""
        depth = inward_px(mask, 3)
        near = dilated(border, 9)
        along, elsewhere = (
            self._edges[border & (depth > 3)],
            self._edges[mask & (depth > 4) & ~near],
        )
        if len(along) <= 5 or len(elsewhere) <= 20:
            return 0.0
        return float(np.quantile(along, 0.3) / max(1e-3, float(np.quantile(elsewhere, 0.75))))

    def _valley(self, first: MaskArray, second: MaskArray, border: MaskArray) -> float:
        """How far the heights along the border fall below the lower of the two tops, 0 to 1."""
        along, *tops = (self._height_mm[part] for part in (border, first, second))
        along, *tops = (heights[np.isfinite(heights)] for heights in (along, *tops))
        if min(len(along), *(len(top) for top in tops)) <= 5:
            return 0.0
        lower = min(float(np.quantile(top, 0.95)) for top in tops)
        return float(np.clip(1.0 - np.median(along) / lower, 0.0, 1.0)) if lower > 5.0 else 0.0

    def _step(self, first: MaskArray, second: MaskArray, border: MaskArray) -> float:
        """The extent to which one part ends in front of the other, 0 to 1; less if little of the border is measured.

        Distances from the camera on each side are continued to the border, where those of one surface meet.
        """
        side = cv2.GaussianBlur(first.astype(np.float32) - second.astype(np.float32), (0, 0), 2.0)
        across = np.stack([cv2.Sobel(side, cv2.CV_32F, 1 - y, y)[border] for y in (1, 0)], axis=-1)
        across = across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-6)
        at, last = np.argwhere(border), np.array(border.shape) - 1
        ends = []
        for part, sign in ((first, 1.0), (second, -1.0)):
            distance = np.where(part, self._distance_mm, np.float32(np.nan))
            near, far = (
                distance[
                    tuple(
                        np.clip(
                            np.rint(at + across * (sign * away / self._pixel_mm)).astype(int),
                            0,
                            last,
                        ).T
                    )
                ]
                for away in STEP_AT_MM
            )
            ends.append(2 * near - far)
        step = ends[0] - ends[1]
        measured = step[np.isfinite(step)]
        if len(measured) <= 5:
            return 0.0
        share = (abs(float(np.median(measured))) - STEP_MM[0]) / (STEP_MM[1] - STEP_MM[0])
        return float(np.clip(share, 0.0, 1.0)) * len(measured) / len(step)


def _contrast(first: Float32Array, second: Float32Array, spread: Float32Array) -> float:
    """How far two weighted Lab colours (3,) lie apart, in spreads (3,); what shade alone would do weighs little.

    Less light scales L* + 16, a* and b* alike, since all three go with the cube root of the light (CIE 15).
    """
    weights = np.array(COLOUR_WEIGHTS, np.float32)
    (light_one, *tint_one), (light_two, *tint_two) = (
        colour / weights * (100 / 255, 1.0, 1.0) - (-16.0, 128.0, 128.0)
        for colour in (first, second)
    )
    darker = min(light_one, light_two)
    tint = np.multiply(tint_one, darker / light_one) - np.multiply(tint_two, darker / light_two)
    lightness = SHADE_WEIGHT * (first[0] - second[0]) / spread[0]
    return float(np.hypot(lightness, np.linalg.norm(tint * weights[1:] / spread[1:])))


def _dented(mask: MaskArray, solidities: tuple[float, float]) -> float:
    """From 0 for an outline that fills the first share of its convex hull to 1 for one that fills the second."""
    return float(
        np.clip((solidities[0] - solidity(mask)) / (solidities[0] - solidities[1]), 0.0, 1.0)
    )


def _is_one_block(mask: MaskArray, scene: Scene, floor_mm: float) -> bool:
    """Whether a mask is a block, slice or pack: level top, upright sides, convex outline."""
    return solidity(mask) > CONVEX_SHARE and flat_top(mask, scene, floor_mm) is not None


def _edge_strength(lab: Float32Array) -> Float32Array:
    """(H, W) the greatest gradient of the weighted colours within a pixel."""
    smooth = cv2.GaussianBlur(lab, (0, 0), 1.0)
    squares = [(cv2.Sobel(smooth, cv2.CV_32F, x, 1 - x) ** 2).sum(axis=-1) for x in (0, 1)]
    return np.asarray(
        cv2.dilate(np.sqrt(squares[0] + squares[1]), np.ones((3, 3), np.uint8)), np.float32
    )


def _is_same_cut(first: MaskArray, two: MaskArray, mask: MaskArray) -> bool:
    """Whether two proposals part the mask alike, whichever side each names."""
    area = np.count_nonzero(mask)
    different = np.count_nonzero(first ^ two)
    return bool(min(different, area - different) < 0.04 * area)


def _inner_half(part: MaskArray) -> MaskArray:
    depth = inward_px(part, 3)
    return np.asarray(part & (depth > 0.5 * depth.max()), np.bool_)


def _opened(mask: MaskArray, size_px: int) -> MaskArray:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size_px, size_px))
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0


def _framed(mask: MaskArray, window: tuple[slice, slice], shape: tuple[int, ...]) -> MaskArray:
    whole = np.zeros(shape, np.bool_)
    whole[window] = mask
    return whole
