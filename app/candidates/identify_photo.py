"""Identify the food in one photograph, or in a box of it, by an index; needs no server.

Also the probable forms of a food by its looks: the candidates of an index, each as its kind usually
lies.
"""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from app.candidates.food_groups import candidate_answers, groups_of_foods
from app.candidates.vcm_json import numbers_of
from app.core.errors import Failure, InvalidInputError
from app.identification.examples import NumberedIndex
from app.identification.food_index import open_index
from app.identification.identifier import Circumstances, Identification, Identifier
from app.identification.kernel_classifier import NONE_PRIOR
from app.identification.metric import Vectors
from app.meals.stored.run_answer import VcmAnswer
from app.nutrition.foods import FoodForm, load_starter_table
from app.nutrition.usual_form import FOOD_HEIGHTS
from app.vision.board.colour_correction import apply_colour, measure_colour
from app.vision.board.marker import find_marker
from app.vision.looks.food_boxes import propose_boxes, share_of_smaller
from app.vision.looks.vcm import VCM_VERSION, describe
from app.vision.looks.vcm_region import Box, Region, region_of_box, regions_of_whole
from app.vision.marker_spec import MarkerSpec
from app.vision.model import ImageArray, LikelyFood, Photo
from app.vision.solids.form_prior import FORMS

UNPOINTED_NONE_PRIOR = 0.5  # of a proposed box: it may as well contain the plate
# probability of none, for all of a photograph, from which on no food fills it: with a food on a
# plate it is 0.80 or more in nine of ten
NONE_OF_PLATE = 0.78


MOST_SHARED = 0.2  # of the smaller of two places that hold different foods
OTHERS_FROM = 0.8  # probability of the best candidate of such a place beside the first


@dataclass(frozen=True, slots=True)
class IdentifiedPlace:
    """box: px."""

    identification: Identification
    box: Box

    @property
    def probability(self) -> float:
        """Return the best candidate's probability."""
        return self.identification.candidates[0].probability


@dataclass(frozen=True, slots=True)
class IdentifiedPhoto:
    """Foods that a photograph shows.

    place: the surest
    others: where other foods surely are
    seconds: duration without decoding
    """

    place: IdentifiedPlace
    others: tuple[IdentifiedPlace, ...]
    seconds: float


def identify_photo(
    photo: Photo, box: Box | None, marker: MarkerSpec | None = None, index: Path | None = None
) -> IdentifiedPhoto:
    """Identify the food in the box, or in the likeliest place.

    marker: in the photograph, to correct its colours.
    index: file of an index; None: the shipped one. Raises InvalidInputError: `box_outside`,
    `food_index_unreadable`, or the marker's failure code if it is not found.
    """
    started = time.perf_counter()
    pixels = photo.pixels_bgr
    if marker is not None:
        board = find_marker(photo, marker)
        if isinstance(board, Failure):
            raise InvalidInputError(f"{board.message} {board.advice}".strip(), code=board.code)
        pixels = apply_colour(pixels, measure_colour(photo, board))
    if box is not None:
        region = region_of_box(pixels, box)
        if region is None:
            height, width = pixels.shape[:2]
            raise InvalidInputError(
                f"The box has less than a pixel in the photograph, which is {width} x {height} px (upright).",
                code="box_outside",
            )
        places = [IdentifiedPlace(_identify([region], identifier_of(index, NONE_PRIOR)), box)]
    else:
        places = identify_unpointed(pixels, identifier_of(index, UNPOINTED_NONE_PRIOR))
    return IdentifiedPhoto(places[0], tuple(places[1:]), time.perf_counter() - started)


def identify_unpointed(pixels: ImageArray, identifier: Identifier) -> list[IdentifiedPlace]:
    """Identify the food that fills a photograph, (H, W, 3), or else those in places of like colour.

    The surest comes first. Of the places apart from the first only those are returned where a food
    surely is.
    """
    height, width = pixels.shape[:2]
    whole = _identify(regions_of_whole(pixels), identifier)
    if whole.none_probability < NONE_OF_PLATE:
        return [IdentifiedPlace(whole, (0.0, 0.0, float(width), float(height)))]
    regions = ((region_of_box(pixels, box), box) for box in propose_boxes(pixels))
    candidates = [
        IdentifiedPlace(_identify([region], identifier), box)
        for region, box in regions
        if region is not None
    ]
    places: list[IdentifiedPlace] = []
    for place in sorted(candidates, key=lambda place: -place.probability):
        is_apart = all(share_of_smaller(place.box, other.box) < MOST_SHARED for other in places)
        if is_apart and (not places or place.probability >= OTHERS_FROM):
            places.append(place)
    return places


def identify_items(items: Iterable[dict[str, Any]], index: Path | None = None) -> None:
    """Replace the items' feature vectors, `vcm`, in an estimate's JSON by candidates.

    index: see identify_photo.
    """
    identifier = identifier_of(index)
    for item in items:
        vcm = item.pop("vcm")
        if vcm is None:
            item.update(candidates=[], none_of_these=None)
            continue
        relative_sd = math.sqrt(sum(sd * sd for sd in item["relative_sd"].values()))
        circumstances = Circumstances(item["volume_ml"], relative_sd)
        vector = numbers_of(VcmAnswer.model_validate(vcm).vector)
        identification = identifier.identify(vector, circumstances)
        item.update(
            candidates=candidates_to_json(identification),
            none_of_these=round(identification.none_probability, 4),
        )


def parse_box(text: str) -> Box:
    """`X,Y,W,H`, px. Raises InvalidInputError, code `box_invalid`."""
    try:
        x, y, width, height = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidInputError(
            f"“{text[:80]}” is no box: write X,Y,W,H in pixels.", code="box_invalid"
        ) from None
    if (
        not all(math.isfinite(each) for each in (x, y, width, height))
        or width <= 0.0
        or height <= 0.0
    ):
        raise InvalidInputError(f"“{text[:80]}” is no box: it has no size.", code="box_invalid")
    return x, y, width, height


def identified_to_json(identified: IdentifiedPhoto) -> dict[str, Any]:
    """What `tada identify --json` prints."""
    return _place_to_json(identified.place) | {
        "others": [_place_to_json(place) for place in identified.others],
        "index_version": identified.place.identification.index_version,
        "seconds": round(identified.seconds, 4),
    }


def _place_to_json(place: IdentifiedPlace) -> dict[str, Any]:
    identification = place.identification
    return {
        "groups": [
            {
                "food": food_name(answer.food, None),
                "food_key": answer.food,
                "probability": round(answer.probability, 4),
            }
            for answer in candidate_answers(identification)
            if answer.is_group
        ],
        "candidates": candidates_to_json(identification),
        "none_of_these": round(identification.none_probability, 4),
        "box": [round(side, 1) for side in place.box],
    }


def candidates_to_json(identification: Identification) -> list[dict[str, object]]:
    """Return candidates with their names in the starter table, best first."""
    return [
        {
            "food": food_name(candidate.food_key, candidate.name),
            "food_key": candidate.food_key,
            "label": candidate.label,
            "probability": round(candidate.probability, 4),
        }
        for candidate in identification.candidates
    ]


def food_name(food_key: str, name: str | None) -> str:
    """Return the food's name in the starter table, or else its name in the index, or else its key."""
    return _starter_names().get(food_key) or name or food_key


def _identify(regions: Sequence[Region], identifier: Identifier) -> Identification:
    """Identify one food by its regions."""
    views = np.stack([describe(region) for region in regions]).astype(np.float64)
    return identifier.identify(views)


@cache
def _starter_names() -> dict[str, str]:
    return {food.key: food.name for food in load_starter_table().foods}


WHOLE = frozenset({"whole", "lying"})


@cache
def identifier_of(index: Path | None, none_prior: float | None = None) -> Identifier:
    """Return the identifier of an index's file, kept for the process; None: of the shipped one.

    Raises InvalidInputError, code `food_index_unreadable`.
    """
    return Identifier(
        NumberedIndex(open_index(index)), groups=groups_of_foods(), none_prior=none_prior
    )


def form_index_version(index: Path | None) -> str | None:
    """Return the version of the index that likely_forms uses; None if it cannot, and then no meal fails by it."""
    try:
        opened = open_index(index)
    except InvalidInputError:
        return None
    return opened.version if opened.vcm_version == VCM_VERSION else None


def likely_foods(vector: Vectors, index: Path | None) -> list[LikelyFood]:
    """Return what a food may be by its description (d,), with the form that each candidate usually has.

    Foods of another form than `whole`, `slab` and `heap`, and those that the starter table lacks,
    are left out; an index that cannot be read says nothing. Raises ValueError if the vector is not
    finite.
    """
    if form_index_version(index) is None:
        return []
    forms = _usual_forms()
    return [
        LikelyFood(form, candidate.probability, FOOD_HEIGHTS.get(candidate.food_key))
        for candidate in identifier_of(index).identify(vector).candidates
        if (form := forms.get(candidate.food_key)) in FORMS
    ]


@cache
def _usual_forms() -> Mapping[str, FoodForm]:
    return {
        food.key: "whole" if food.form in WHOLE else food.form
        for food in load_starter_table().foods
    }
