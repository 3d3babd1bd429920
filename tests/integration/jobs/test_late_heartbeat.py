"""A heartbeat that comes late: the lease is lost once somebody has taken it, and not before."""

import pytest

from app.children.faults import JobLeft
from app.jobs.leases import DatabaseLease, new_executor
from app.jobs.times import WorkerTimes

pytestmark = pytest.mark.parametrize("kind", ["postgres"])  # on SQLite a worker's life is a lock
NEVER_FRESH = WorkerTimes(lease=0.0)


def test_lease_that_ran_out_and_that_nobody_took_is_renewed_and_guards(database):
    lease = started(database)
    assert lease.renew()
    with database.write() as session:
        lease.guard(session)


def test_worker_that_was_held_up_does_not_bury_itself(database):
    """A look for dead workers that comes before the late heartbeat."""
    lease = started(database)
    assert lease.bury(set()) == set()
    assert lease.renew()


def test_lease_that_was_taken_is_neither_renewed_nor_guards(database):
    lease, other = started(database), started(database)
    assert other.bury({lease.executor_id}) == {lease.executor_id}
    assert not lease.renew()
    with database.write() as session, pytest.raises(JobLeft):
        lease.guard(session)


def test_lease_under_which_is_just_being_saved_is_passed_over_by_a_takeover(database):
    lease, other = started(database), started(database)
    with database.write() as session:
        lease.guard(session)
        assert other.bury({lease.executor_id}) == set()
    assert other.bury({lease.executor_id}) == {lease.executor_id}


def started(database):
    """The lease of a worker whose heartbeats all come too late."""
    lease = DatabaseLease(database, new_executor(), NEVER_FRESH)
    lease.acquire()
    return lease
