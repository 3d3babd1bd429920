import subprocess
import sys

import pytest

from app.children.faults import JobLeft
from app.db.session import Database
from app.jobs.leases import FileLease, living_workers, lock_files, lock_folder, new_executor
from tests.support.waiting import wait_until


@pytest.fixture
def database(tmp_path):
    found = Database(f"sqlite:///{tmp_path / 'tada.sqlite3'}")
    yield found
    found.dispose()


def lease(database):
    return FileLease(lock_folder(database), new_executor())


def test_locked_file_is_life_its_release_death_and_a_lease_whose_file_was_removed_is_lost(database):
    first, second = lease(database), lease(database)
    first.acquire()
    second.acquire()
    assert {w.executor_id for w in living_workers(database)} == {first.executor_id, second.executor_id}
    assert second.bury({first.executor_id, "never-seen"}) == {"never-seen"}
    first.release()
    assert [w.executor_id for w in living_workers(database)] == [second.executor_id]
    assert second.bury({first.executor_id}) == {first.executor_id}
    second.release()
    assert lock_files(lock_folder(database)) == []
    mine = lease(database)
    mine.acquire()
    mine.guard(None)
    lock_files(lock_folder(database))[0].unlink()
    assert not mine.renew()
    with pytest.raises(JobLeft):
        mine.guard(None)
    mine.release()


def test_lock_of_a_killed_process_is_dropped_and_its_file_removed(database, tmp_path):
    script = """
import sys, time
from app.db.session import Database
from app.jobs.leases import FileLease, lock_folder, new_executor
lease = FileLease(lock_folder(Database(sys.argv[1])), new_executor())
lease.acquire()
print(lease.executor_id, flush=True)
time.sleep(600)
"""
    mine = lease(database)
    mine.acquire()
    with subprocess.Popen([sys.executable, "-c", script, database.url], stdout=subprocess.PIPE, text=True) as other:
        name = other.stdout.readline().strip()
        assert mine.bury({name}) == set()
        other.kill()
    wait_until(lambda: mine.bury({name}) == {name}, "the dead process's lock to go")
    assert [path.stem for path in lock_files(lock_folder(database))] == [mine.executor_id]
    mine.release()
