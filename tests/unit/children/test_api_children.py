"""The API's children: what goes wrong in one is told as an error of its request; a crowd is turned away."""

import uuid

import pytest

from app.children.api_children import ApiChildren, PhotographError, Whose
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
    with children._line.place("a study", "a caller"), pytest.raises(UnavailableError) as caught:
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
