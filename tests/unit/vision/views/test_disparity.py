import cv2
import numpy as np
import pytest

from app.vision.views.disparity import looks_alike, match_dense


def texture(height=180, width=240, seed=0):
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.uniform(0, 255, (height, width)).astype(np.float32), (0, 0), 1.5)
    return np.clip((noise - noise.mean()) * 4 + 128, 0, 255).astype(np.float32)


def shifted(image, shift):
    columns, rows = np.meshgrid(
        np.arange(image.shape[1], dtype=np.float32), np.arange(image.shape[0], dtype=np.float32)
    )
    return cv2.remap(image, columns + np.float32(shift), rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def as_bgr(image):
    return np.repeat(np.clip(image + 0.5, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


@pytest.mark.parametrize("shift", [6.0, 6.25, 6.5, 7.3])
def test_no_part_of_a_pixel_is_preferred_whatever_the_light(shift):
    image = texture()
    bgr, before = as_bgr(image), as_bgr(image)
    found = match_dense(bgr, as_bgr(shifted(image, shift)), (-2.0, 24.0)).parallax_px[30:-30, 50:-50]
    assert np.array_equal(bgr, before)
    assert np.isfinite(found).mean() > 0.95
    assert abs(np.nanmedian(found) - shift) < 0.03
    assert np.nanstd(found) < 0.15
    darker = match_dense(bgr, as_bgr(0.6 * shifted(image, shift) + 30), (-2.0, 24.0)).parallax_px[30:-30, 50:-50]
    assert np.isfinite(darker).mean() > 0.9
    assert abs(np.nanmedian(darker) - shift) < 0.1


def test_standard_deviation_tells_how_far_off_parallaxes_are():
    image = texture()
    rng = np.random.default_rng(0)
    noisy = [picture + rng.normal(0, 8, image.shape) for picture in (image, shifted(image, 7.3))]
    found = match_dense(as_bgr(noisy[0]), as_bgr(noisy[1]), (-2.0, 24.0))
    inner = (slice(30, -30), slice(50, -50))
    spread = np.nanstd(found.parallax_px[inner])
    assert 0.3 < spread / np.nanmedian(found.sd_px[inner]) < 3.0  # a guess at how many pixels are independent is in it
    assert np.array_equal(np.isnan(found.sd_px), np.isnan(found.parallax_px))


def test_featureless_region_gives_nan():
    image = texture()
    image[60:140, 60:180] = 128.0
    noisy = [image + np.random.default_rng(k).normal(0, 0.2, image.shape).astype(np.float32) for k in (0, 1)]
    found = match_dense(as_bgr(noisy[0]), as_bgr(shifted(noisy[1], 5.0)), (0.0, 16.0)).parallax_px
    assert np.isnan(found[98:102, 110:130]).all()


def test_noise_is_told_from_what_looks_alike():
    image, rng = texture(), np.random.default_rng(1)
    left, right = image.copy(), shifted(image, 8.0)
    for picture in (left, right):
        picture[:, 120:] = 128 + rng.normal(0, 12, picture[:, 120:].shape)
    parallax = np.full((90, 120), 8.0, np.float32)
    is_alike = looks_alike(*(np.clip(picture, 0, 255).astype(np.uint8) for picture in (left, right)), parallax)
    assert is_alike[10:-10, 15:50].mean() > 0.95
    assert is_alike[10:-10, 75:110].mean() < 0.02
