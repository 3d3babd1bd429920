"""Which volumes and amounts may be believed."""

WIDEST = 3.0  # factor between a volume and either end of its 90 % interval
MOST = 3000.0  # g or ml of one food at one meal
MOST_APART = 5.0  # factor between what a person states and what was measured


def says_nothing(volume_ml: float, low_ml: float, high_ml: float) -> bool:
    """Return whether either end of the 90 % interval is more than a factor of WIDEST from the volume."""
    return high_ml > WIDEST * volume_ml or low_ml * WIDEST < volume_ml


def is_implausible(stated: float, measured: float | None) -> bool:
    """Return whether a stated amount exceeds MOST, or is more than a factor of MOST_APART from the measured one.

    Both are in g, or both in ml. measured: None where nothing was measured.
    """
    is_apart = measured is not None and not measured / MOST_APART <= stated <= measured * MOST_APART
    return stated > MOST or is_apart
