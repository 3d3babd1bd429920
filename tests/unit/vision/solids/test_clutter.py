import numpy as np

from app.vision.geometry.mesh import ClosedShape
from app.vision.scene.segmentation import Region
from app.vision.solids.measured_item import MIN_VOLUME_ML, MeasuredItem, Volume, without_clutter

NO_SHAPE = ClosedShape(np.zeros((0, 3)), np.zeros((0, 3), np.int64))


def item(volume_ml, hint=None, item_sd=0.05, interval=(0.9, 1.1)):
    interval_ml = tuple(share * volume_ml for share in interval)
    volume = Volume(volume_ml, interval_ml, {"item": item_sd}, "circle", np.zeros(2), (), np.zeros((0, 3)), NO_SHAPE)
    return MeasuredItem(Region(np.ones((4, 4), bool), hint), np.zeros((0, 3)), 0.0, volume, ())


def test_crumbs_that_nobody_pointed_at_are_left_out_and_nothing_but_them_is_no_food():
    apple, crumb, pointed_at = item(180.0), item(MIN_VOLUME_ML / 2), item(MIN_VOLUME_ML / 2, hint=0)
    assert without_clutter([crumb, apple]) == [apple]
    assert without_clutter([pointed_at]) == [pointed_at]
    unknown = MeasuredItem(Region(np.ones((4, 4), bool)), np.zeros((0, 3)), 0.0, None, ("not_measurable",))
    assert without_clutter([unknown, crumb]) == [unknown]
    assert without_clutter([item(1.0), item(2.0)]).code == "no_food_found"
    assert without_clutter([None]).code == without_clutter([None, item(1.0)]).code == "food_not_measured"


def test_piece_that_no_form_explains_is_left_out_unless_somebody_pointed_at_it():
    apple, piece, pointed_at = item(180.0), item(300.0, item_sd=0.7), item(300.0, hint=0, item_sd=0.7)
    assert without_clutter([piece, apple, pointed_at]) == [apple, pointed_at]


def test_volume_whose_interval_spans_more_than_a_third_to_three_times_is_not_given():
    believed, too_low, too_high = (item(60.0, interval=ends) for ends in ((0.34, 2.9), (0.3, 1.5), (0.5, 3.1)))
    first, *others = without_clutter([believed, too_low, too_high])
    assert first == believed
    assert [(other.volume, other.flags) for other in others] == [(None, ("not_measurable",))] * 2
