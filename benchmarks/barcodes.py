"""How many of 100 drawn packs the server reads the barcode of, how many wrongly, and how long a photograph takes.

    python benchmarks/barcodes.py

Photographs of 1600 x 1200 px: a third each EAN-13, UPC-A and EAN-8, flat or round a can, tilted up
to 35 degrees about both axes and turned by any angle, out of focus, shaken, dim and noisy
(tests/support/packs.py).
"""

import time
from collections import Counter

import cv2
import numpy as np

from app.meals.estimate.barcode_task import read_barcodes
from tests.support.packs import gtin_of, photograph_pack

PACKS = 100
DIGITS = (12, 11, 7)  # without the check digit


def main() -> None:
    random = np.random.default_rng(20261130)
    outcomes: Counter[str] = Counter()
    seconds = 0.0
    for number in range(PACKS):
        body = "".join(map(str, random.integers(0, 10, DIGITS[number % len(DIGITS)])))
        code = gtin_of(body)
        encoded = np.frombuffer(photograph_pack(code, number), np.uint8)
        picture = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
        begun = time.perf_counter()
        read = read_barcodes(picture)
        seconds += time.perf_counter() - begun
        outcome = "none" if not read else "several" if len(read) > 1 else "wrong"
        if [digits.lstrip("0") for digits in read] == [code.lstrip("0")]:
            outcome = "right"
        outcomes[f"{len(code)} digits, {outcome}"] += 1
        outcomes[outcome] += 1
    print(dict(sorted(outcomes.items())), f"{seconds / PACKS * 1000:.0f} ms each")


if __name__ == "__main__":
    main()
