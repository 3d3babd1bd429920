"""Which real pairs there are, and their sums; no photograph is needed for either."""

import pytest

from benchmarks import real_pairs as real


def test_refused_pairs_are_counted_and_do_not_enter_the_error_and_nothing_measured_has_none():
    measured = {"error": 0.1, "inside": True}
    summary = real.summarise([measured, {"error": -0.02, "inside": False}, {"error": None, "inside": False}])
    assert (summary["pairs"], summary["measured"]) == (3, 2)
    assert summary["mean_error"] == pytest.approx(6.0)
    assert summary["bias"] == pytest.approx(4.0)
    assert summary["coverage"] == pytest.approx(50.0)
    assert real.summarise([{"error": None, "inside": False}]) == {"pairs": 1, "measured": 0}
