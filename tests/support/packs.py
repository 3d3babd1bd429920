"""Photographs of packs with a barcode, drawn: bent round the pack, tilted, out of focus, dim and noisy."""

import cv2
import numpy as np
import zxingcpp

MODULE_PX = 8  # of the flat drawing


def gtin_of(body):
    """Return twelve digits with their check digit."""
    return body + str(-sum(int(digit) * (3 - 2 * (place % 2)) for place, digit in enumerate(reversed(body))) % 10)


def draw_label(code, random):
    """Return a label with print around its barcode, BGR, and the barcode's middle, px."""
    kind = {8: zxingcpp.BarcodeFormat.EAN8, 12: zxingcpp.BarcodeFormat.UPCA}.get(
        len(code), zxingcpp.BarcodeFormat.EAN13
    )
    barcode = zxingcpp.create_barcode(code, kind)
    bars = np.array(zxingcpp.write_barcode_to_image(barcode, scale=MODULE_PX, add_quiet_zones=True))
    bars = cv2.resize(bars, None, fx=1, fy=1.3)
    height, width = bars.shape
    paper, ink = random.integers(60, 255, 3).tolist(), random.integers(0, 120, 3).tolist()
    label = np.full((2 * height, 2 * width, 3), paper, np.uint8)
    for y in range(60, 2 * height, 90):
        words = "".join(random.choice(list("abcdefghij klmno"), 60))
        cv2.putText(label, words, (20, y), cv2.FONT_HERSHEY_SIMPLEX, 2, ink, 5, cv2.LINE_AA)
    top, left = random.integers(40, height - 40), random.integers(40, width - 40)
    label[top : top + height, left : left + width] = bars[..., None]
    return label, left + width / 2, top + height / 2


def photograph_pack(code, seed):
    """Return a JPEG of 1600 x 1200 px or upright, in which a module of the barcode is 3 to 6 px wide before tilts."""
    random = np.random.default_rng(seed)
    label, x, y = draw_label(code, random)
    height, width = label.shape[:2]
    scale = random.uniform(3.0, 6.0) / MODULE_PX
    # round a can: x is bent to the sine of its angle
    bend = random.uniform(0.1, 0.9) if random.random() < 0.5 else 0.01
    across = np.sin(np.linspace(-bend, bend, width)) / np.sin(bend)
    columns = np.interp(np.linspace(-1, 1, width), across, np.arange(width)).astype(np.float32)
    rows = np.arange(height, dtype=np.float32)
    label = cv2.remap(label, np.tile(columns, (height, 1)), np.tile(rows[:, None], (1, width)), cv2.INTER_LINEAR)
    # tilted about both axes up to 35 degrees, turned by any angle
    tilts, turn = random.uniform(-35, 35, 2), random.uniform(0, 360)
    axes = [
        cv2.Rodrigues(np.radians(angle) * np.eye(3)[axis])[0]
        for axis, angle in ((0, tilts[0]), (1, tilts[1]), (2, turn))
    ]
    rotation = axes[0] @ axes[1] @ axes[2]
    focal = 1500.0
    centred = np.array([[1, 0, -x], [0, 1, -y], [0, 0, 1]])
    plane = np.column_stack([rotation[:, 0], rotation[:, 1], [0, 0, focal / scale]])
    camera = np.array([[focal, 0, 800], [0, focal, 600], [0, 0, 1]])
    table = tuple(int(value) for value in random.integers(40, 220, 3))
    image = cv2.warpPerspective(
        label,
        camera @ plane @ centred,
        (1600, 1200),
        flags=cv2.INTER_AREA,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=table,
    )
    image = cv2.GaussianBlur(image, (0, 0), random.uniform(0.5, 1.6))
    shake = int(random.integers(1, 6))
    kernel = cv2.warpAffine(
        np.full((1, shake), 1 / shake, np.float32),
        cv2.getRotationMatrix2D((shake / 2, 0.5), random.uniform(0, 180), 1),
        (7, 7),
    )
    image = cv2.filter2D(image, -1, kernel / max(kernel.sum(), 1e-6))
    light = np.linspace(random.uniform(0.4, 1.0), random.uniform(0.4, 1.0), 1600)[None, :, None]
    noisy = image * light + random.normal(0, random.uniform(2, 8), image.shape)
    if random.random() < 0.5:
        noisy = np.rot90(noisy)
    return cv2.imencode(".jpg", np.clip(noisy, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
