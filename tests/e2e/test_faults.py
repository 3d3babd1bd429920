"""Faults of every kind while phones send: nothing acknowledged is lost, nothing is doubled. docs/faults.md."""

import os
import pathlib
import shutil
import tempfile

import pytest

from tests.e2e.faults.schedule import FAULTS, WITH_WORK_ONLY
from tests.e2e.faults.storm import storm

MEALS = int(os.environ.get("TADA_TEST_MEALS", "16"))  # 100 and more for a long storm by hand (docs/development.md)
SEED = int(os.environ.get("TADA_TEST_SEED", "20261122"))
ROUNDS = int(os.environ.get("TADA_TEST_FAULTS", max(1, MEALS // 16)))  # of every fault that the deployment can have
KINDS = os.environ.get("TADA_TEST_FAULT_KINDS", "")  # only faults whose names hold this
IS_LONG = MEALS > 16
LONGEST_GAP_SECONDS = 2.0 if IS_LONG else 0.6


@pytest.fixture
def storm_folder():
    """Not pytest's own: the database runs as another user, who must be able to come there."""
    folder = pathlib.Path(tempfile.mkdtemp(prefix="tada-faults-"))
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


DEPLOYMENTS = [("sqlite", "files"), ("postgres", "s3")]
if IS_LONG:  # its faults are all in the one before
    DEPLOYMENTS.append(("postgres", "files"))


SMALL = {  # one of each way: a death, a loss on the way, a full disk, a wrong clock
    *("server killed", "estimate's child killed"),  # a server's worker dies with it
    *("phone answers lost", "disk of files full", "clock of api jumps"),
}


def test_nothing_acknowledged_is_lost_or_doubled_in_a_small_storm(storm_folder):
    assert FAULTS.keys() >= WITH_WORK_ONLY | SMALL
    how = {"seed": SEED, "meals": 5, "rounds": 1, "longest_gap": LONGEST_GAP_SECONDS}
    outcome = storm(storm_folder, "sqlite", "files", is_wanted=SMALL.__contains__, is_small=True, **how)
    require_order(outcome, rounds=1, how_again=f"TADA_TEST_SEED={SEED}\n{outcome.table}")


@pytest.mark.slow
@pytest.mark.parametrize(("database", "store"), DEPLOYMENTS)
def test_nothing_acknowledged_is_lost_or_doubled_whatever_breaks(storm_folder, database, store, capsys):
    variables = f"TADA_TEST_SEED={SEED} TADA_TEST_MEALS={MEALS} TADA_TEST_FAULTS={ROUNDS}"
    if KINDS:
        variables += f" TADA_TEST_FAULT_KINDS='{KINDS}'"
    how_again = f"again by: {variables} pytest tests/e2e/test_faults.py -k '{database}-{store}'"
    how = {"seed": SEED, "meals": MEALS, "rounds": ROUNDS, "longest_gap": LONGEST_GAP_SECONDS}
    outcome = storm(storm_folder, database, store, is_wanted=lambda name: KINDS in name, **how)
    with capsys.disabled():
        print(f"\n{database} + {store}, {how_again}\n{outcome.table}")  # noqa: T201
    require_order(outcome, ROUNDS, how_again)
    enough = ROUNDS * len(outcome.kinds) / 2  # without the certain ones: only if there are meals to work on
    assert sum(outcome.injected.values()) >= enough, f"too few meals for these faults; {how_again}"


def require_order(outcome, rounds, how_again):
    assert outcome.lost == [], how_again
    assert outcome.duplicated == [], how_again
    assert outcome.others == [], how_again
    certain = {name: rounds for name in outcome.kinds if name not in WITH_WORK_ONLY}
    assert {name: outcome.injected.get(name, 0) for name in certain} == certain, how_again
