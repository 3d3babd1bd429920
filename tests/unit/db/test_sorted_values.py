"""Runs of values, each in order: what is told of them together is what is told of all values put together."""

import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.db import sorted_values
from app.db.sorted_values import Runs, SortedValues

VALUES = st.one_of(st.integers(-5, 5).map(float), st.floats(-1e6, 1e6, allow_subnormal=False))
RUNS = st.lists(st.lists(VALUES, max_size=30), min_size=1, max_size=12).filter(any)


@pytest.fixture(autouse=True, scope="module")
def halved():
    """So that few values are halved as many are."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sorted_values, "SORT_LIMIT", 3)
        yield


@given(RUNS)
def test_runs_tell_what_their_values_tell(runs):
    together = Runs.of(map(SortedValues.of, runs))
    values = sorted(value for run in runs for value in run)
    spread = max(map(abs, values)) or 1.0
    assert [together.at(rank) for rank in range(len(values))] == values
    assert len(together) == len(values)
    assert together.median == statistics.median(values)
    assert (together.least, together.greatest) == (values[0], values[-1])
    assert together.mean == pytest.approx(statistics.fmean(values), rel=1e-9, abs=1e-9 * spread)
    squares = sum((value - statistics.fmean(values)) ** 2 for value in values)
    assert together.squares == pytest.approx(squares, rel=1e-6, abs=1e-9 * spread**2)
    for value in values:
        assert together.below(value) == sum(each < value for each in values)
        assert together.up_to(value) == sum(each <= value for each in values)


def test_bytes_are_the_same_on_every_machine(monkeypatch):
    kept = SortedValues.of([2.0, 1.0]).to_bytes()
    assert kept.hex() == "000000000000f83f000000000000e03f000000000000f03f0000000000000040"
    monkeypatch.setattr(sorted_values.sys, "byteorder", "big")
    other = SortedValues.from_bytes(kept)
    other.values.byteswap()  # what a big-endian machine would have read
    assert list(other.values) == [1.0, 2.0]
