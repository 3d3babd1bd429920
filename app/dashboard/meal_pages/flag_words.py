"""What each flag says and what to do, in the words of docs/flags.md, docs/after-meal.md and docs/review.md."""

from collections.abc import Mapping

FLAGS: Mapping[str, str] = {
    # of a measurement
    "low_texture": "Less than half of the food's surface could be measured from the two views; its outline carries "
    "the form. Look at the outline.",
    "vessel_library": "It is a liquid in a vessel of the study's library: only its level was measured.",
    "inside_guessed": "It lies in a bowl: its top is measured, what lies below is taken from the bowl's outer wall. "
    "The interval is wide for that.",
    "not_measurable": "It was looked at and its volume cannot be measured. Set the amount, or count it as "
    "missing, never as 0.",
    "hint_missed": "The phone pointed at a food where nothing could be measured. Draw it, set the amount, or reject "
    "it.",
    "focal_unknown": "Neither a calibration nor EXIF tells the focal length; the interval is the wider for it. Ask for "
    "photographs with their EXIF data, or calibrate the phone.",
    "form_unlikely": "A person said how it lies, and the photographs clearly speak for another form. Check the "
    "form, or the outline.",
    "support_not_measured": "What the food rests on was not seen: on a raised plate it comes out too large.",
    "clock_doubtful": "It came long after it was photographed by the phone's clock, or before: the clock may have been "
    "wrong, and the day with it. Ask the participant.",
    # of its food
    "food_identified": "The server alone says what it is, with a probability of 0.8 or more. Confirm it, or choose "
    "another.",
    "food_doubtful": "A hint says what it is, and the index gives another food 0.95 or more. The hint's food counts.",
    # of a region that was drawn
    "remeasuring": "The drawn region is being measured. Until then the amount is the one of before.",
    "remeasure_failed": "The drawn region could not be measured again: draw it anew, or tell the amount.",
    "replaced": "It was split or merged: other items stand in its place.",
    "undone": "It was made by a word that was taken back.",
    "of_rejected": "It was declared with an item that was rejected.",
    # of what was left
    "after_failed": "The after-meal pair could not be measured: the record is of all that was served.",
    "leftover_unmatched": "Something was left, and it is not clear of which item. Say of which.",
    "leftover_ambiguous": "More than one item would do for this piece.",
    "leftover_not_measurable": "Something was left of it, and how much is not known: what was eaten is not known.",
    "refuse_assumed": "Taken for peel, core or bone by its amount, and not taken off. It may be a small piece of food.",
    "refuse_possible": "Taken for food by its amount, and taken off. It may be a peel that lies hollow.",
    # of a photograph's colours
    "marker_partly_shadowed": "Some of the board's paper is darker than the rest: a shadow, or something covers it.",
    "marker_overexposed": "The board's paper is clipped: expose for the paper.",
    "marker_washed_out": "The board's black squares are too light: glare, or haze on the lens. Colours come out pale.",
    "marker_colours_left_out": "Some coloured squares were of no use; the others made the correction.",
    "colour_white_only": "Too few of the board's colours could be used: white balance and exposure only.",
    "marker_darker_than_scene": "The board lies in a shadow: the exposure was lowered.",
    "colour_uncorrected": "The board's paper is too dark or not to be seen: colours are as taken.",
}


def flag_words(code: str) -> str:
    """What a flag says; "" for one of a newer server's."""
    return FLAGS.get(code, "")
