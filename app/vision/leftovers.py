"""Which item of the meal a piece in the after-meal pair was left of: by place, colour, volume and what is told. Pure.

Each kind of evidence is a log-likelihood ratio, "it is of this item" against "it is anything else"; each allows that it
fails, since plates are turned, boards pushed and a bitten apple is white. One assignment maximises their sum. A piece
whose assignment is not clearly better than every other explanation stays unmatched: a wrong match would move grams from
one food to another, an unmatched piece is looked at by a person.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from app.vision.model import Float64Array, ItemTraits

MIN_MARGIN = math.log(4.0)  # by which the sum must be better than without the match: four to one
# what lies there after a meal is of the meal, rarely a napkin or a second helping
OF_SOME_ITEM = math.log(0.95 / 0.05)
ONE_MORE_PIECE = -math.log(4.0)  # most foods are left in one piece
SAME_FOOD = 4.0  # what a food that was told weighs; a person may name another food of the same kind
# how often the evidence speaks at all; else it says nothing
SAME_LOOK_SHARE, STAYED_SHARE = 0.7, 0.7
# CIELAB units a channel: of one food in two photographs; of any two foods
SAME_LOOK_SD, ANY_LOOK_SD = 10.0, 40.0
PLACE_SD_MM, TABLE_SD_MM = 15.0, 150.0  # of a place measured twice; of any two things on a table
NO_SMALLER_SD = 0.1  # relative, of the excess of a piece over what was served
BOARD_STAYED, BOARD_TURNED, NO_FRAME, ALL_MOVED = 0.6, 0.1, 0.15, 0.15  # before looking
MIN_LEVER_MM = 40.0  # between two pieces, for a motion to follow from them
MAX_MOTIONS = 40
MAX_PIECES = 4  # of one item
FORCED = 1e3
Z_90 = 1.6448536269514722


@dataclass(frozen=True, slots=True)
class Sight:
    """An item as it was seen in its pair. relative_sd: its volume's, all parts together. food: its key, where known."""

    traits: ItemTraits
    volume_ml: float | None
    relative_sd: float
    food: str | None = None


@dataclass(frozen=True, slots=True)
class Match:
    """What a piece is of. served: index, None: unmatched. margin: by how much, at least, the logarithm gains by it.

    is_ambiguous: unmatched, and there was more than one good explanation (else there was none).
    """

    served: int | None
    margin: float
    is_ambiguous: bool = False


@dataclass(frozen=True, slots=True)
class _Motion:
    """From the after-meal pair's frame to the other one, p = rotation @ q + shift_mm. log_prior: before looking."""

    rotation: Float64Array
    shift_mm: Float64Array
    log_prior: float


def match_pieces(
    served: Sequence[Sight], left: Sequence[Sight], stated: Mapping[int, int | None] | None = None
) -> list[Match]:
    """Return what each piece is of, in the order of `left`.

    stated: piece -> item that a person named, None: of none of them.
    """
    if not served or not left:
        return [Match(None, 0.0)] * len(left)
    stated = stated or {}
    unplaced = _scores(served, left)
    totals = [  # (log prior, (left, served) scores) of each way in which the board may have moved
        (math.log(NO_FRAME), _with_statements(unplaced, stated)),
        *(
            (motion.log_prior, _with_statements(unplaced + _places(served, left, motion), stated))
            for motion in _motions(served, left)
        ),
    ]
    assigned = [_assign(table, prior) for prior, table in totals]
    best, chosen = max(assigned, key=lambda each: each[0])
    # a motion that explains all worse by the margin can only explain it worse still without a match
    near = [
        each for each, (total, _) in zip(totals, assigned, strict=True) if total > best - MIN_MARGIN
    ]
    far = max((total for total, _ in assigned if total <= best - MIN_MARGIN), default=-math.inf)
    matches = []
    for piece, item in enumerate(chosen):
        if item is None:
            others = any(table[piece].max() > 0.0 for _, table in totals) and piece not in stated
            matches.append(Match(None, 0.0, is_ambiguous=others))
            continue
        without = max(
            _assign(_without(table, piece, item, served), prior)[0] for prior, table in near
        )
        margin = best - max(without, far)
        is_sure = margin >= MIN_MARGIN
        matches.append(Match(item if is_sure else None, margin, is_ambiguous=not is_sure))
    return _within_what_was_served(served, left, matches, stated)


def _scores(served: Sequence[Sight], left: Sequence[Sight]) -> Float64Array:
    """(left, served) all evidence but the places'."""
    out = np.full((len(left), len(served)), OF_SOME_ITEM - math.log(len(served)))
    for j, piece in enumerate(left):
        for i, item in enumerate(served):
            out[j, i] += _look(item, piece) + _volume(item, piece) + _food(item, piece)
    return out


def _with_statements(table: Float64Array, stated: Mapping[int, int | None]) -> Float64Array:
    out = table.copy()
    for piece, item in stated.items():
        out[piece] = -FORCED
        if item is not None:
            out[piece, item] = FORCED
    return out


def _look(item: Sight, piece: Sight) -> float:
    """Colours of the same food, or, bitten, cut or stewed, of any."""
    if item.traits.lab is None or piece.traits.lab is None:
        return 0.0
    distance, any_sd = (
        math.dist(item.traits.lab, piece.traits.lab),
        math.hypot(SAME_LOOK_SD, ANY_LOOK_SD),
    )
    own = 3.0 * math.log(any_sd / SAME_LOOK_SD) - 0.5 * distance**2 * (
        SAME_LOOK_SD**-2 - any_sd**-2
    )
    return math.log(SAME_LOOK_SHARE * math.exp(own) + 1.0 - SAME_LOOK_SHARE)


def _places(served: Sequence[Sight], left: Sequence[Sight], motion: _Motion) -> Float64Array:
    """(left, served): a piece lies where its item lay, somewhere in its outline; or it was moved."""
    at, was = _centres(left) @ motion.rotation.T + motion.shift_mm, _centres(served)
    distance = np.hypot(*np.moveaxis(at[:, None] - was[None], -1, 0))
    own_sd, any_sd = (
        np.array([_place_sd(item) for item in served]),
        math.hypot(TABLE_SD_MM, PLACE_SD_MM),
    )
    own = 2.0 * np.log(any_sd / own_sd) - 0.5 * distance**2 * (own_sd**-2 - any_sd**-2)
    score = np.log(STAYED_SHARE * np.exp(own) + 1.0 - STAYED_SHARE)
    return np.where(np.isnan(score), 0.0, score)


def _centres(sights: Sequence[Sight]) -> Float64Array:
    """(n, 2) mm, NaN where a place is not known."""
    return np.array([each.traits.centre_mm or (np.nan, np.nan) for each in sights], np.float64)


def _place_sd(item: Sight) -> float:
    return math.hypot(PLACE_SD_MM, 0.5 * (item.traits.radius_mm or 0.0))


def _volume(item: Sight, piece: Sight) -> float:
    """What is left is not more than what was served, but for doubt."""
    if item.volume_ml is None or piece.volume_ml is None or piece.volume_ml <= item.volume_ml:
        return 0.0
    excess = math.log(piece.volume_ml / item.volume_ml) / math.hypot(
        item.relative_sd, piece.relative_sd, NO_SMALLER_SD
    )
    return -0.5 * excess**2


def _food(item: Sight, piece: Sight) -> float:
    if item.food is None or piece.food is None:
        return 0.0
    return SAME_FOOD if item.food == piece.food else -SAME_FOOD


def _motions(served: Sequence[Sight], left: Sequence[Sight]) -> Iterator[_Motion]:
    """How the board may have moved against the meal: not at all, by half a turn, or as two pieces together tell.

    Half a turn: a board whose sides add up to an even number of squares looks the same then.
    """
    still = np.zeros(2)
    yield _Motion(np.eye(2), still, math.log(BOARD_STAYED))
    yield _Motion(-np.eye(2), still, math.log(BOARD_TURNED))
    # each motion is fitted to what it is judged by: its two places and its angle are paid for, once (Occam's factor)
    paid = 2.0 * math.log(TABLE_SD_MM / PLACE_SD_MM) + math.log(
        2.0 * math.pi * TABLE_SD_MM / PLACE_SD_MM
    )
    for rotation, shift in _by_two(served, left):
        yield _Motion(rotation, shift, math.log(ALL_MOVED) - paid)


def _by_two(
    served: Sequence[Sight], left: Sequence[Sight]
) -> Iterator[tuple[Float64Array, Float64Array]]:
    """(rotation, shift) that bring two pieces onto two items that lay as far apart, the best fitting first."""
    was, at = _centres(served), _centres(left)
    sds = np.array([_place_sd(item) for item in served])
    # from the row's to the column's
    displacement, across = was[None] - was[:, None], at[None] - at[:, None]
    lever, length = (
        np.hypot(*np.moveaxis(across, -1, 0)),
        np.hypot(*np.moveaxis(displacement, -1, 0)),
    )
    misfit = np.abs(lever[:, :, None, None] - length) / np.hypot(sds[:, None], sds[None])
    misfit[np.tril_indices(len(left))] = np.inf  # each two pieces once
    misfit[:, :, np.arange(len(served)), np.arange(len(served))] = np.inf
    misfit[~(lever >= MIN_LEVER_MM)] = np.inf
    fitting = np.argwhere(misfit <= 2.0)
    order = np.argsort(misfit[tuple(fitting.T)], kind="stable")[:MAX_MOTIONS]
    for a, b, i, k in fitting[order]:
        angle = math.atan2(*displacement[i, k][::-1]) - math.atan2(*across[a, b][::-1])
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        yield turn, 0.5 * (was[i] + was[k]) - turn @ (0.5 * (at[a] + at[b]))


def _assign(table: Float64Array, prior: float) -> tuple[float, list[int | None]]:
    """(sum, item of each piece) of the best assignment: each item once, and again for further pieces at a price."""
    pieces, items = table.shape
    copies = min(pieces, MAX_PIECES)
    columns = [table + (ONE_MORE_PIECE if copy else 0.0) for copy in range(copies)]
    # the last: unmatched, for any of them
    whole = np.hstack([*columns, np.zeros((pieces, pieces))])
    rows, chosen = scipy.optimize.linear_sum_assignment(whole, maximize=True)
    places: list[int | None] = [None] * pieces
    for row, column in zip(rows, chosen, strict=True):
        if column < copies * items:
            places[row] = int(column % items)
    return prior + float(whole[rows, chosen].sum()), places


def _without(table: Float64Array, piece: int, item: int, served: Sequence[Sight]) -> Float64Array:
    """The scores with this match ruled out; with it those of the same food, between which it changes no total."""
    food = served[item].food
    same = [
        i
        for i, other in enumerate(served)
        if i == item or (food is not None and other.food == food)
    ]
    out = table.copy()
    out[piece, same] = -FORCED * len(table)
    return out


def _within_what_was_served(
    served: Sequence[Sight],
    left: Sequence[Sight],
    matches: Sequence[Match],
    stated: Mapping[int, int | None],
) -> list[Match]:
    """Several pieces of one item hold no more together than was served: else the least sure one is nobody's."""
    out = list(matches)
    for item, whole in enumerate(served):
        pieces = sorted(
            (j for j, match in enumerate(out) if match.served == item), key=lambda j: -out[j].margin
        )
        while len(pieces) > 1 and _is_more(whole, [left[j] for j in pieces]):
            last = next((j for j in reversed(pieces) if j not in stated), None)
            if last is None:
                break
            pieces.remove(last)
            out[last] = Match(None, out[last].margin, is_ambiguous=True)
    return out


def _is_more(whole: Sight, pieces: Sequence[Sight]) -> bool:
    volumes = [piece.volume_ml for piece in pieces if piece.volume_ml is not None]
    if whole.volume_ml is None or not volumes:
        return False
    sd = math.hypot(whole.relative_sd, max(piece.relative_sd for piece in pieces), NO_SMALLER_SD)
    return math.log(math.fsum(volumes) / whole.volume_ml) > Z_90 * sd
