"""Few places, many who want them: nobody takes all of them away."""

import threading

import pytest

from app.children.fair_line import FairLine, LineFullError
from tests.support.waiting import PATIENCE_SECONDS, wait_until

SOON = 0.002


class Crowd:
    """Callers in threads; each holds its place until it is let go. served: in what order."""

    def __init__(self, line):
        self.line = line
        self.served, self.refused = [], []
        self.ends = {}
        self.threads = []

    def come(self, name, study, caller=None, *, is_costly=False):
        before = len(self.line._waiting) + len(self.served) + len(self.refused)
        self.ends[name] = threading.Event()
        thread = threading.Thread(target=self._hold, args=(name, study, caller or name, is_costly))
        thread.start()
        self.threads.append(thread)
        wait_until(
            lambda: len(self.line._waiting) + len(self.served) + len(self.refused) > before, name, interval_seconds=SOON
        )

    def _hold(self, name, study, caller, is_costly):
        try:
            with self.line.place(study, caller, is_costly=is_costly):
                self.served.append(name)
                assert self.ends[name].wait(PATIENCE_SECONDS)
        except LineFullError:
            self.refused.append(name)

    def let_go(self, name):
        count = len(self.served)
        is_wanted = bool(self.line._waiting)
        self.ends[name].set()
        if is_wanted:
            wait_until(lambda: len(self.served) > count, "the next to be served", interval_seconds=SOON)

    def finish(self):
        for end in self.ends.values():
            end.set()
        for thread in self.threads:
            thread.join(PATIENCE_SECONDS)


@pytest.fixture
def crowd_of():
    crowds = []

    def make(places=1, most_waiting=8, wait_seconds=PATIENCE_SECONDS):
        crowds.append(Crowd(FairLine(places, most_waiting=most_waiting, wait_seconds=wait_seconds)))
        return crowds[-1]

    yield make
    for crowd in crowds:
        crowd.finish()


def test_first_come_is_first_served_within_a_study_and_studies_take_turns(crowd_of):
    crowd = crowd_of()
    for name in ("a", "b", "c"):
        crowd.come(name, "study")
    crowd.let_go("a")
    crowd.let_go("b")
    assert crowd.served == ["a", "b", "c"]
    crowd = crowd_of()
    for name in ("a1", "a2", "a3", "a4"):
        crowd.come(name, "a")
    crowd.come("b1", "b")
    crowd.let_go("a1")
    assert crowd.served == ["a1", "b1"]
    crowd.let_go("b1")
    assert crowd.served == ["a1", "b1", "a2"]


def test_caller_has_one_place_at_a_time_though_others_are_free(crowd_of):
    crowd = crowd_of(places=2)
    crowd.come("a1", "study", caller="phone")
    crowd.come("a2", "study", caller="phone")
    crowd.come("b1", "study", caller="another phone")
    wait_until(lambda: len(crowd.served) == 2, "two to be served")
    assert crowd.served == ["a1", "b1"]
    crowd.let_go("a1")
    assert crowd.served == ["a1", "b1", "a2"]


def test_costly_work_of_one_study_leaves_a_place_for_another_unless_there_is_only_one(crowd_of):
    crowd = crowd_of(places=2)
    for name in ("a1", "a2", "a3"):
        crowd.come(name, "a", is_costly=True)
    crowd.come("b1", "b")
    wait_until(lambda: len(crowd.served) == 2, "two to be served")
    assert crowd.served == ["a1", "b1"]
    crowd.ends["b1"].set()
    crowd.threads[-1].join(PATIENCE_SECONDS)
    assert crowd.served == ["a1", "b1"]  # the place stays free
    crowd.come("b2", "b")
    assert crowd.served == ["a1", "b1", "b2"]
    crowd.let_go("a1")
    assert crowd.served == ["a1", "b1", "b2", "a2"]
    crowd = crowd_of(places=1)
    crowd.come("a1", "a", is_costly=True)
    wait_until(lambda: crowd.served == ["a1"], "a1")


def test_one_caller_and_one_study_leave_room_in_the_line_for_others(crowd_of):
    crowd = crowd_of(most_waiting=8)
    crowd.come("holds", "x")
    for n in range(6):
        crowd.come(f"phone {n}", "a", caller="phone")
    assert crowd.refused == ["phone 4", "phone 5"]
    for n in range(4):
        crowd.come(f"others {n}", "a")
    assert crowd.refused[2:] == ["others 2", "others 3"]
    crowd.come("b", "b")
    assert "b" not in crowd.refused
    crowd.let_go("holds")
    assert "b" in crowd.served or crowd.served[-1] == "phone 0"


def test_who_waits_too_long_is_refused_and_keeps_nobody_else_waiting(crowd_of):
    crowd = crowd_of(wait_seconds=0.2)
    crowd.come("a", "study")
    crowd.come("b", "study")
    wait_until(lambda: crowd.refused == ["b"], "b to be refused")
    crowd.let_go("a")
    crowd.threads[0].join(PATIENCE_SECONDS)
    crowd.come("c", "study")
    wait_until(lambda: crowd.served == ["a", "c"], "c to be served")
