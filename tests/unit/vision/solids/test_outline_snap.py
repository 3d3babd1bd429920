import cv2
import numpy as np
import pytest

from app.vision.geometry.pictures import lab_of
from app.vision.solids.outline_snap import Nearest, colours_beside, outline, rings_of_mask, snap

MIDDLE_PX, RADIUS_PX = np.array([80.3, 70.7]), 40.4
SIZE = (150, 170)
FOOD, CLOTH = (40, 90, 200), (190, 180, 170)  # BGR
REACH_PX = 4.0


def distance_px(shape=SIZE, finer=1, middle=MIDDLE_PX):
    y, x = np.mgrid[: shape[0] * finer, : shape[1] * finer]
    return np.hypot((x + 0.5) / finer - 0.5 - middle[0], (y + 0.5) / finer - 0.5 - middle[1])


def photograph(blur_px=0.8, noise=2.0, food=FOOD, cloth=CLOTH, hole_px=0.0, seed=0):
    """A disc, antialiased, on cloth."""
    distance = distance_px(finer=4)
    is_food = (distance < RADIUS_PX) & (distance >= hole_px)
    share = cv2.resize(is_food.astype(np.float32), SIZE[::-1], interpolation=cv2.INTER_AREA)[..., None]
    image = share * np.array(food) + (1 - share) * np.array(cloth)
    image = cv2.GaussianBlur(image, (0, 0), blur_px)
    image += np.random.default_rng(seed).normal(0, noise, image.shape)
    return np.clip(image + 0.5, 0, 255).astype(np.uint8)


def rough_mask(grown_px=0.0, hole_px=0.0):
    distance = distance_px()
    return (distance < RADIUS_PX + grown_px) & (distance >= hole_px)


def radii(line):
    return np.linalg.norm(line.points_px - MIDDLE_PX, axis=1)


def test_ring_of_a_mask_is_its_outline_with_outward_normals():
    (ring,) = rings_of_mask(rough_mask())
    offset = ring.points_px - MIDDLE_PX
    assert np.abs(np.linalg.norm(offset, axis=1) - RADIUS_PX).max() < 0.7  # a mask knows whole pixels only
    assert np.isclose(np.linalg.norm(offset, axis=1).mean(), RADIUS_PX, atol=0.2)
    assert ((ring.normals * offset).sum(axis=1) / RADIUS_PX > 0.97).all()
    steps = np.linalg.norm(ring.points_px - np.roll(ring.points_px, 1, axis=0), axis=1)
    assert np.ptp(steps) < 0.2


@pytest.mark.parametrize("grown_px", [-2.0, 2.0])
@pytest.mark.parametrize("blur_px", [0.5, 1.5])
def test_snapping_finds_the_edge_of_a_disc_under_blur_and_noise(grown_px, blur_px):
    line = snap(lab_of(photograph(blur_px)), rings_of_mask(rough_mask(grown_px)), REACH_PX)
    off = radii(line) - RADIUS_PX
    # L*a*b* is a curved scale: half way between two colours in it is not where a pixel is half covered.
    assert abs(off.mean()) < 0.1 + 0.15 * blur_px
    assert off.std() < 0.2  # profiles are averaged along the ring, so that a mask's steps stay in part
    assert line.weights.min() > 0.8


@pytest.mark.parametrize("sheen_px", [3.0, 6.0])
def test_glossy_limb_ends_where_it_ends_and_not_where_it_is_half_its_surroundings_colour(sheen_px):
    """At a grazing angle a peel mirrors the cloth: its colour drifts towards the cloth's before the edge."""
    distance = distance_px(finer=4)
    sheen = 0.5 * np.clip(1 - (RADIUS_PX - distance) / sheen_px, 0, 1) ** 2
    share = np.where(distance < RADIUS_PX, 1 - sheen, 0.0).astype(np.float32)
    share = cv2.resize(share, SIZE[::-1], interpolation=cv2.INTER_AREA)[..., None]
    image = cv2.GaussianBlur(share * np.array(FOOD) + (1 - share) * np.array(CLOTH), (0, 0), 0.6)
    image += np.random.default_rng(1).normal(0, 1.5, image.shape)
    line = snap(lab_of(np.clip(image + 0.5, 0, 255).astype(np.uint8)), rings_of_mask(rough_mask()), REACH_PX)
    assert abs(np.median(radii(line)) - RADIUS_PX) < 0.45


def test_no_contrast_and_edges_beyond_reach_have_no_weight():
    rings = rings_of_mask(rough_mask())
    line = snap(lab_of(photograph(food=CLOTH)), rings, REACH_PX)
    assert line.weights.max() < 0.15
    assert np.abs(radii(line) - RADIUS_PX).max() < 1.5
    beyond_reach = snap(lab_of(photograph()), rings_of_mask(rough_mask(14.0)), 2.0)
    assert np.median(beyond_reach.weights) < 0.2


def test_hole_is_snapped_as_well_as_the_outer_edge():
    hole_px = 18.0
    line = snap(lab_of(photograph(hole_px=hole_px)), rings_of_mask(rough_mask(1.5, hole_px + 1.5)), REACH_PX)
    is_inner = radii(line) < 30
    assert np.isclose(radii(line)[is_inner].mean(), hole_px, atol=0.25)
    assert np.isclose(radii(line)[~is_inner].mean(), RADIUS_PX, atol=0.25)
    assert len(line.points_px) == len(line.normals)  # several rings are searched as one
    assert line.nearest.query(line.points_px[-1:])[1][0] == len(line.points_px) - 1


def test_known_colours_keep_the_outline_off_a_shadow():
    image = photograph(noise=1.0)
    shade = (distance_px(middle=(MIDDLE_PX[0] + 5.0, MIDDLE_PX[1])) < RADIUS_PX + 4.0)[..., None]
    is_cloth = (distance_px() > RADIUS_PX + 0.5)[..., None]
    image = np.where(shade & is_cloth, image * 0.75, image).astype(np.uint8)
    lab = lab_of(image)
    inside, outside = (lab_of(np.full((1, 1, 3), colour, np.uint8))[0, 0].astype(float) for colour in (FOOD, CLOTH))

    def reference(points):
        return np.tile(inside, (len(points), 1)), np.tile(outside * [0.8, 0.9, 0.9], (len(points), 1))

    line = snap(lab, rings_of_mask(rough_mask(3.0)), REACH_PX, reference)
    assert abs(np.median(radii(line)) - RADIUS_PX) < 0.5


def test_colours_beside_an_outline_are_those_of_both_sides():
    lab = lab_of(photograph(noise=0.0))
    rings = rings_of_mask(rough_mask())
    found = colours_beside(lab, outline(rings, np.ones(len(rings[0].points_px))))
    for side, colour in zip(found, (FOOD, CLOTH), strict=True):
        assert np.allclose(side, lab_of(np.full((1, 1, 3), colour, np.uint8))[0, 0], atol=1.5)


@pytest.mark.parametrize("count", [1, 2, 9, 11, 700])
def test_nearest_is_that_of_all_distances(count):
    rng = np.random.default_rng(count)
    points, asked = (rng.uniform(0, 4000, (n, 2)) for n in (count, 150))
    distances = np.linalg.norm(asked[:, None] - points, axis=2)
    nearest, first = Nearest(points), points.copy()
    points += 1000.0  # which changes no answer
    distance, index = nearest.query(asked)
    assert np.allclose(distance, distances.min(axis=1), atol=1e-3)
    assert np.allclose(distances[np.arange(len(asked)), index], distances.min(axis=1), atol=1e-3)
    distance, index = nearest.query(first)
    assert np.array_equal(index, np.arange(count))
    assert (distance == 0).all()
