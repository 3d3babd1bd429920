"""The benchmark of real photographs: its halves, its yardsticks and its report, on made figures."""

from pathlib import Path

import pytest

from benchmarks.weighed_photographs import HALVES, Measured, Photographed, half_of, lines, photographed, yardsticks


def row(specimen, true_ml, coins, volume_ml=None, code=""):
    shown = Photographed(Path("none.jpg"), None, specimen[:-1], specimen, true_ml, (0.0, 0.0), coins)
    return Measured(shown, volume_ml, (0.9 * volume_ml, 1.1 * volume_ml) if volume_ml else None, code)


ROWS = [
    row("apple1", 100.0, 4.0, 105.0),
    row("apple2", 800.0, 16.0, 400.0),
    row("pear1", 50.0, 1.0, code="image_too_small"),
]


def test_yardsticks_are_by_the_other_specimens_of_the_food():
    errors = yardsticks(ROWS)
    assert errors["constant per food"] == pytest.approx(100 * (7.0 + 0.875) / 2)
    assert errors["area^1.5 per food"] == pytest.approx(0.0, abs=1e-9)  # both are 12.5 ml by coins to the power of 1.5


def test_report_counts_what_was_refused_apart():
    report = list(lines(ROWS))
    assert "| apple | 2 | 2 | 27.5 | -22.5 | 1 |" in report
    assert "| pear | 1 | 0 | | | |" in report
    assert "| all | 3 | 2 | 27.5 | -22.5 | 1 |" in report
    assert report[-1] == "not measured: pear1 image_too_small"


def test_each_specimen_at_hand_is_in_one_half(shared_data):
    folder = shared_data / "photos" / "ecustfd"
    halves = [[shown.specimen for shown in photographed(folder, half)] for half in HALVES]
    together = halves[0] + halves[1]
    assert len(set(together)) == len(together) > 100
    assert all(half_of(specimen) == half for half, of_half in zip(HALVES, halves, strict=True) for specimen in of_half)
