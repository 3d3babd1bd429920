"""A thing of known size beside the plate, which gives the scale where no board is at hand: `coin:eur-1`, `coin:25.0`.

Text in -> KnownObject out. board/round_object.py finds it; the API, which only checks the text, needs no OpenCV.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from app.core.errors import InvalidInputError
from app.vision.marker_spec import MarkerSpec, parse_marker

# Diameter and thickness, mm, of round coins that have been struck in one size only.
COINS: Mapping[str, tuple[float, float]] = {
    "eur-0.01": (16.25, 1.67),
    "eur-0.02": (18.75, 1.67),
    "eur-0.05": (21.25, 1.67),
    "eur-0.10": (19.75, 1.93),
    "eur-0.20": (22.25, 2.14),
    "eur-0.50": (24.25, 2.38),
    "eur-1": (23.25, 2.33),
    "eur-2": (25.75, 2.2),
    "usd-0.01": (19.05, 1.52),
    "usd-0.05": (21.21, 1.95),
    "usd-0.10": (17.91, 1.35),
    "usd-0.25": (24.26, 1.75),
}
USUAL_THICKNESS_MM = 1.9  # of a coin that is told by its diameter alone
DIAMETER_MM = (14.0, 45.0)
TEXT = re.compile(
    r"coin:(?P<name>[a-z]{3}-\d+(?:\.\d+)?)|coin:(?P<mm>\d{2}(?:\.\d{1,3})?)", re.ASCII
)
FORMS = ("coin:CURRENCY-VALUE", "coin:MM")


@dataclass(frozen=True, slots=True)
class KnownObject:
    """A coin. diameter_mm, thick_mm: what a photograph shows of it lies that much over the table."""

    text: str
    diameter_mm: float
    thick_mm: float

    def __str__(self) -> str:
        return self.text


def parse_scale(text: str) -> MarkerSpec | KnownObject:
    """Return the board or the known object that a text announces. Raises InvalidInputError, code "marker_invalid"."""
    return parse_known_object(text) if text.startswith("coin:") else parse_marker(text)


def parse_known_object(text: str) -> KnownObject:
    """Return the object that a text announces. Raises InvalidInputError, code "marker_invalid"."""
    parts = TEXT.fullmatch(text)
    if parts is None:
        raise _refused(f"“{text[:80]}” is no coin: write {' or '.join(FORMS)}, such as coin:eur-1.")
    if parts["name"] is not None:
        if parts["name"] not in COINS:
            raise _refused(
                f"The coin {parts['name']} is not known; give its diameter in mm, as in coin:25.0. "
                f"There are {', '.join(COINS)}."
            )
        return KnownObject(text, *COINS[parts["name"]])
    diameter_mm = float(parts["mm"])
    if not DIAMETER_MM[0] <= diameter_mm <= DIAMETER_MM[1]:
        raise _refused(
            f"A coin is {DIAMETER_MM[0]:g} to {DIAMETER_MM[1]:g} mm wide, not {diameter_mm:g} mm."
        )
    return KnownObject(text, diameter_mm, USUAL_THICKNESS_MM)


def _refused(message: str) -> InvalidInputError:
    return InvalidInputError(message, code="marker_invalid")
