"""Which volumes and amounts may be believed."""

WIDEST = 3.0  # factor between a volume and either end of its 90 % interval
MOST = 3000.0  # g or ml of one food at one meal
MOST_APART = 5.0  # factor between what a person states and what was measured


def says_nothing(volume_ml: float, low_ml: float, high_ml: float) -> bool:
    """Return whether a volume's 90 % interval reaches above WIDEST times or below the WIDEST-th part of it."""
    return high_ml > WIDEST * volume_ml or low_ml * WIDEST < volume_ml


def is_implausible(stated: float, measured: float | None) -> bool:
    """Return whether nobody eats so much of one food, or the photographs show far more or less of it.

    Both in g or both in ml. measured: None where nothing was measured.
    """
    is_apart = measured is not None and not measured / MOST_APART <= stated <= measured * MOST_APART
    return stated > MOST or is_apart
