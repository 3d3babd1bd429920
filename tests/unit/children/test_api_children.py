"""The API's children: what goes wrong in one is told as an error of its request; a crowd is turned away."""

import contextlib
import uuid

import pytest

from app.children.api_children import WAITING_A_CHILD, ApiChildren, PhotographError, Whose
from app.core.errors import TadaError, UnavailableError
from app.core.settings import Settings

TASKS = "tests.unit.children.fake_tasks:TASKS"


@pytest.fixture(scope="module")
def children(tmp_path_factory):
    children = ApiChildren(
        Settings(data_dir=tmp_path_factory.mktemp("api"), api_children=1), tasks=TASKS, wait_seconds=0.3
    )
    yield children
    children.close()


def somebody():
    """Another caller of another study at each call."""
    return Whose(uuid.uuid4(), uuid.uuid4())


def describe(children, word):
    return children.run("describe", {"word": word}, seconds=30, whose=somebody())["echo"]["word"]


@pytest.mark.parametrize(
    ("task", "error", "code", "status", "is_retryable"),
    [
        ("raise", TadaError, "internal_error", 500, False),
        ("segfault", PhotographError, "photograph_not_decoded", 422, False),
        ("hang", UnavailableError, "server_busy", 503, True),  # a slow or full machine does not blame the photograph
        ("killed", UnavailableError, "server_busy", 503, True),
        ("fill_disk", UnavailableError, "server_busy", 503, True),
    ],
)
def test_bad_end_is_an_error_of_the_request_and_the_next_one_is_answered(
    children, task, error, code, status, is_retryable
):
    describe(children, "warm")
    with pytest.raises(error) as caught:
        children.run(task, {}, seconds=0.3, whose=somebody())
    assert (caught.value.code, caught.value.status, caught.value.retryable) == (code, status, is_retryable)
    assert describe(children, "next") == "next"


def test_request_that_waits_too_long_is_told_to_come_back(children):
    with children._admitted(somebody(), is_costly=False), pytest.raises(UnavailableError) as caught:
        describe(children, "too much")
    assert (caught.value.code, caught.value.retryable) == ("server_busy", True)
    assert describe(children, "next") == "next"


def test_photograph_that_broke_a_child_is_refused_without_another(children):
    whose = somebody()
    for _ in range(2):
        with pytest.raises(PhotographError):
            children.run("segfault", {}, seconds=30, whose=whose, photograph_sha256="ab" * 32)
    with pytest.raises(PhotographError):  # where it hung, the server would be busy
        children.run("hang", {}, seconds=1, whose=whose, photograph_sha256="ab" * 32)
    assert describe(children, "another") == "another"


@pytest.fixture
def two_children(tmp_path):
    """Whoever does not find a place at once is refused."""
    children = ApiChildren(Settings(data_dir=tmp_path, api_children=2), tasks=TASKS, wait_seconds=0.0)
    yield children
    children.close()


def is_admitted(children, whose, *, is_costly=False):
    try:
        with children._admitted(whose, is_costly=is_costly):
            return True
    except UnavailableError:
        return False


def test_caller_has_one_child_at_a_time_though_others_are_free(two_children):
    caller = somebody()
    with two_children._admitted(caller, is_costly=False):
        assert not is_admitted(two_children, caller)
        assert is_admitted(two_children, somebody())
    assert is_admitted(two_children, caller)


def test_costly_photographs_leave_a_child_for_others_unless_there_is_only_one(two_children, children):
    with two_children._admitted(somebody(), is_costly=True):
        assert not is_admitted(two_children, somebody(), is_costly=True)
        assert is_admitted(two_children, somebody())
    assert is_admitted(children, somebody(), is_costly=True)


def test_one_caller_and_one_study_leave_room_for_others(two_children):
    room = 2 * (1 + WAITING_A_CHILD)
    study, caller = uuid.uuid4(), uuid.uuid4()
    two_children._wait_seconds = 30.0  # whoever is refused now found no room
    with contextlib.ExitStack() as taken:
        for _ in range(room - room // 2):
            taken.enter_context(two_children._room_of_caller.of(caller))
        with pytest.raises(UnavailableError):
            two_children.run("describe", {"word": "x"}, seconds=30, whose=Whose(study, caller))
        for _ in range(room - room // 4):
            taken.enter_context(two_children._room_of_study.of(study))
        with pytest.raises(UnavailableError):
            two_children.run("describe", {"word": "x"}, seconds=30, whose=Whose(study, uuid.uuid4()))
        assert is_admitted(two_children, somebody())
