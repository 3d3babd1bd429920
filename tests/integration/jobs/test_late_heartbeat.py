"""A heartbeat that comes late: the lease is lost once somebody has taken it, and not before.

The clock is the database's, and it may be set back: by hand, by NTP, by a failover elsewhere.
"""

from types import SimpleNamespace

import pytest
import sqlalchemy as sa

from app.children.faults import JobLeft
from app.jobs.leases import DatabaseLease, living_workers, new_executor
from app.jobs.queries import WorkerTimes

pytestmark = pytest.mark.parametrize("kind", ["postgres"])  # on SQLite a worker's life is a lock
NEVER_FRESH = WorkerTimes(lease=0.0)


def test_lease_that_ran_out_and_that_nobody_took_is_renewed_and_guards(database):
    """Also after its own look for dead workers that came before the late heartbeat."""
    lease = started(database)
    assert lease.bury(set()) == set()
    assert lease.renew()
    with database.write() as session:
        lease.guard(session)


def test_lease_that_was_taken_is_neither_renewed_nor_guards_and_one_under_which_is_just_saved_is_not_taken(database):
    lease, other = started(database), started(database)
    with database.write() as session:
        lease.guard(session)
        assert other.bury({lease.executor_id}) == set()
    assert other.bury({lease.executor_id}) == {lease.executor_id}
    assert not lease.renew()
    with database.write() as session, pytest.raises(JobLeft):
        lease.guard(session)


def test_lease_from_before_the_clock_went_back_is_taken_unless_it_is_renewed(database, monkeypatch):
    clock, times = SimpleNamespace(seconds=0.0), WorkerTimes(lease=60.0)
    monkeypatch.setattr("app.jobs.leases.time", SimpleNamespace(monotonic=lambda: clock.seconds))
    dead, living = started(database, times), started(database, times)
    both = {dead.executor_id, living.executor_id}
    with database.write() as session:
        session.execute(sa.text("UPDATE worker_lease SET heartbeat_at = heartbeat_at + interval '1 hour'"))
    other = started(database, times)
    assert [worker.executor_id for worker in living_workers(database, times)] == [other.executor_id]
    assert other.bury(both) == set()
    assert living.renew()
    clock.seconds = 61.0
    assert other.bury(both) == {dead.executor_id}
    assert not dead.renew()
    assert living.renew()


def started(database, times=NEVER_FRESH):
    """The lease of a worker; by these times all its heartbeats come too late."""
    lease = DatabaseLease(database, new_executor(), times)
    lease.acquire()
    return lease
