"""Which intervals say something about a volume."""

WIDEST = 3.0  # factor between a volume and either end of its 90 % interval


def says_nothing(volume_ml: float, low_ml: float, high_ml: float) -> bool:
    """Return whether a volume's 90 % interval reaches above WIDEST times or below the WIDEST-th part of it."""
    return high_ml > WIDEST * volume_ml or low_ml * WIDEST < volume_ml
