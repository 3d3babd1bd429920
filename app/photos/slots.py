"""Names of a meal's photographs: its views in the order in which they were taken, and the pair after it."""

from typing import Literal, get_args

PhotographSlot = Literal[
    "left", "right", "view3", "view4", "view5", "view6", "view7", "view8", "after_left", "after_right"
]
SLOTS: tuple[str, ...] = get_args(PhotographSlot)
VIEW_SLOTS, AFTER_SLOTS = SLOTS[:-2], SLOTS[-2:]
PAIR_SLOTS = VIEW_SLOTS[:2]
