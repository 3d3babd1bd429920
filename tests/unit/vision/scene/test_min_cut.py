import numpy as np

from app.vision.scene.min_cut import cut_in_two

SHAPE = (40, 60)
NOTHING = np.zeros(SHAPE, bool)


def features(edge_column=None, grain=2):
    image = np.full((*SHAPE, 2), 100, np.uint8)
    if edge_column is not None:
        image[:, edge_column:] = 160
    image[::2, ::2] += np.uint8(grain)  # grain, against which an edge is strong
    return image


def test_sure_pixels_take_their_label():
    ratio = np.where(np.arange(SHAPE[1]) < 25, 9.0, -9.0) * np.ones(SHAPE)
    assert np.array_equal(cut_in_two(ratio.astype(np.float32), features(), NOTHING, NOTHING), ratio > 0)
    for value in (1.0, -1.0):
        assert (cut_in_two(np.full(SHAPE, value, np.float32), features(), NOTHING, NOTHING) == (value > 0)).all()


def test_border_of_doubtful_pixels_lies_on_the_edge():
    ratio = np.zeros(SHAPE, np.float32)
    always, never = NOTHING.copy(), NOTHING.copy()
    always[:, :5], never[:, -5:] = True, True
    found = cut_in_two(ratio, features(edge_column=37), never, always)
    assert np.array_equal(found, np.broadcast_to(np.arange(SHAPE[1]) < 37, SHAPE))


def test_fixed_pixels_stay_and_never_goes_before_always():
    ratio = np.full(SHAPE, 8.0, np.float32)
    never = NOTHING.copy()
    never[:, :10] = True
    found = cut_in_two(ratio, features(), never, np.ones(SHAPE, bool))
    assert np.array_equal(found, ~never)
