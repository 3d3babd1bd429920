"""The meaning of each flag and what to do, as in docs/flags.md, docs/after-meal.md and docs/review.md."""

import uuid
from collections.abc import Collection, Mapping, Sequence

from app.records.meal_schemas import ItemOut

FLAGS: Mapping[str, str] = {
    # of a measurement
    "low_texture": "Less than half of the food's surface could be measured from the two views; its outline "
    "determines the form. Check the outline.",
    "vessel_library": "It is a liquid in a vessel of the study's library: only its level was measured.",
    "inside_guessed": "It lies in a bowl: its top is measured, the part below is derived from the bowl's outer wall. "
    "The interval is therefore wide.",
    "not_measurable": "It was examined, and its volume cannot be told within a factor of three, or the second "
    "photograph does not show it where the first one puts it. Set the amount; a pair from closer, at a slant, with the "
    "whole food in view and nothing moved measures more. Else count it as missing, never as 0.",
    "hint_missed": "The phone pointed at a food where nothing could be measured. Draw it, set the amount, or reject "
    "it.",
    "scale_from_depth": "No marker was named: the depth map gave the scale, and its lowest large plane is the table.",
    "scale_from_rig": "A stereo rig took the photographs: its calibration gave the scale, and the table was found in "
    "the scene. Colours are as taken.",
    "depth_ignored": "A depth map contradicts the marker: its table lies elsewhere. It took no part.",
    "scale_from_poses": "The marker was not seen in both photographs: the poses that the phone's tracking gave are the "
    "scale, good to a few percent, and the table was found in the scene. Unless the left photograph shows a marker, "
    "colours are as taken.",
    "scale_from_object": "A coin beside the plate gave the scale, which is less exact than a board: "
    "volumes are good to a tenth or two. Colours are as taken.",
    "camera_unknown": "The photographs do not say with which focal length they were taken, and a "
    "coin cannot tell it. Ask for photographs with their EXIF data, or calibrate the phone.",
    "single_view": "One photograph alone shows it, which widens the interval: its height follows from its outline and "
    "from what its form usually is. Check the food and its form.",
    "view_from_side": "The second photograph was taken to be from the side, and its outline there gave the height. If "
    "that photograph is not from the side, the volume is wrong.",
    "focal_unknown": "The focal length is in neither a calibration nor EXIF, which widens the interval. Ask for "
    "photographs with their EXIF data, or calibrate the phone.",
    "few_matches": "Beside the marker the photographs share hardly any point: the marker alone places the cameras, and "
    "a small movement between the photographs could go unseen. Check the outline.",
    "scale_doubtful": "By the marker's size as it was declared, the dishes and foods are far from usual sizes. Compare "
    "the printed board with the study's marker.",
    "form_unlikely": "A person said how it lies, and the photographs clearly support another form. Check the "
    "form, or the outline.",
    "support_not_measured": "The surface under the food was not seen: on a raised plate it comes out too large.",
    "clock_doubtful": "By the phone's clock it arrived long after it was photographed, or before: the clock may "
    "have been wrong, and the day with it. Ask the participant.",
    "copied": "The participant took food and amount from a former meal or a favourite.",
    # of a photograph
    "reencoded": "Its file was malformed, so that its location could only be taken out by writing its picture anew. "
    "Focal length, time and orientation were kept, other metadata were not.",
    # of its food
    "food_identified": "The server alone determined the food, with a probability of 0.85 or more. Confirm it, or "
    "choose another.",
    "food_doubtful": "A hint names the food, and the index gives another food 0.95 or more. The hint's food counts.",
    # of a region that was drawn
    "remeasuring": "The drawn region is being measured. Until then the former amount applies.",
    "remeasure_failed": "The drawn region could not be measured: draw it again, or set the amount.",
    "replaced": "It was split or merged: other items replace it.",
    "undone": "It was created by an event that was undone.",
    "of_rejected": "It was declared with an item that was rejected.",
    # of what was left
    "after_failed": "The after-meal pair could not be measured: the record covers all that was served.",
    "leftover_unmatched": "Something was left, and it is not clear of which item. Assign it.",
    "leftover_ambiguous": "More than one item fits this piece.",
    "implausible_amount": "Nobody eats so much of one food, or the photographs show far more or less. Was it a slip of "
    "the finger? Correct the amount, or confirm it.",
    "leftover_not_measurable": "Something was left of it, but the amount is unknown, so what was eaten is unknown.",
    "refuse_assumed": "Taken for peel, core or bone by its amount, and not subtracted. It may be a small piece of "
    "food.",
    "refuse_possible": "Taken for food by its amount, and subtracted. It may be a peel that lies hollow.",
    # of a photograph's colours
    "marker_partly_shadowed": "Some of the board's paper is darker than the rest: a shadow, or something covers it.",
    "marker_overexposed": "The board's paper is clipped: expose for the paper.",
    "marker_washed_out": "The board's black squares are too light: glare, or haze on the lens. Colours come out pale.",
    "marker_colours_left_out": "Some coloured squares were unusable; the correction uses the others.",
    "colour_white_only": "Too few of the board's colours could be used: white balance and exposure only.",
    "marker_darker_than_scene": "The board lies in a shadow: the exposure was lowered.",
    "colour_uncorrected": "The board's paper is too dark or not visible: colours are as taken.",
}


def reasons_of(food: object, consumed_g: float | None, flags: Collection[str]) -> list[str]:
    """Return the causes of doubt about an item, in words; none: only its interval is."""
    reasons = (
        ["Nobody has stated the food, and the server is not sure enough."] if food is None else []
    )
    if consumed_g is None:
        reasons.append("The eaten amount is unknown.")
    reasons += [FLAGS.get(flag, flag.replace("_", " ") + ".") for flag in flags]
    return reasons


def doubts_of(items: Sequence[ItemOut], numbers: Mapping[uuid.UUID, int]) -> dict[str, list[str]]:
    """Return cause of doubt -> the items that have it, by number and food; without rejected and reviewed items."""
    doubts: dict[str, list[str]] = {}
    for item in items:
        if item.reviewed or item.status == "rejected":
            continue
        name = (
            f"{numbers[item.id]}: {item.food.name}"
            if item.food is not None
            else str(numbers[item.id])
        )
        for reason in reasons_of(item.food, item.consumed_g, item.flags):
            doubts.setdefault(reason, []).append(name)
    return doubts


def flag_meaning(code: str) -> str:
    """Return what a flag means; "" for a flag of a newer server."""
    return FLAGS.get(code, "")
