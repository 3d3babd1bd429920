"""Names of a meal's photographs, of the depth maps beside them and of its voice note, in the order of lists."""

from typing import Literal, get_args

PhotographSlot = Literal[
    "left",
    "right",
    "view3",
    "view4",
    "view5",
    "view6",
    "view7",
    "view8",
    "after_left",
    "after_right",
]
DepthSlot = Literal["left_depth", "right_depth", "left_confidence", "right_confidence"]
VoiceSlot = Literal["voice_note"]
ImageSlot = Literal[PhotographSlot, DepthSlot, VoiceSlot]
PHOTOGRAPH_SLOTS: tuple[str, ...] = get_args(PhotographSlot)
VIEW_SLOTS, AFTER_SLOTS = PHOTOGRAPH_SLOTS[:-2], PHOTOGRAPH_SLOTS[-2:]
PAIR_SLOTS = VIEW_SLOTS[:2]
DEPTH_SLOTS: tuple[str, ...] = get_args(DepthSlot)
CONFIDENCE_SLOTS = DEPTH_SLOTS[2:]
VOICE_NOTE: VoiceSlot = "voice_note"
FILE_SLOTS = frozenset({*DEPTH_SLOTS, VOICE_NOTE})  # returned as they are stored
SLOTS = (*VIEW_SLOTS, *DEPTH_SLOTS, *AFTER_SLOTS, VOICE_NOTE)


def image_name(slot: str) -> str:
    """The name of a slot's image in messages: left photograph, left depth map, left confidence map, voice note."""
    if slot == VOICE_NOTE:
        return "voice note"
    return f"{slot.replace('_', ' ')} map" if slot in DEPTH_SLOTS else f"{slot} photograph"


def depth_slot(view: str) -> str:
    """The slot of the depth map of this view."""
    return f"{view}_depth"


def confidence_slot(view: str) -> str:
    """The slot of the confidence map of this view's depth map."""
    return f"{view}_confidence"
