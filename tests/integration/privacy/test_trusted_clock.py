"""A wrong clock erases nothing; a right one erases on time, however quiet the study is."""

import json
from datetime import timedelta
from types import SimpleNamespace

import pytest
import sqlalchemy as sa
from structlog.testing import capture_logs
from typer.testing import CliRunner

from app.cli.main import cli
from app.meals.stored.models import MealImage
from app.operations import chores
from app.operations.chores import TrustedClock, worker_chores
from app.operations.queries import database_now
from app.people.access.secret_box import SecretBox
from app.people.models import Study
from app.people.privacy_queries import clock_doubted_seconds
from tests.support.photographs import pair

HOUR, DAY = 3600.0, 86400.0
RETENTION_DAYS = 90


@pytest.fixture
def clocks(monkeypatch):
    """The clock on the wall is `ahead` seconds ahead of the true time; `running` is the clock that nobody sets."""
    clocks = SimpleNamespace(ahead=0.0, running=0.0)
    monkeypatch.setattr(chores, "database_now", lambda session: database_now(session) + timedelta(seconds=clocks.ahead))
    return clocks


@pytest.fixture
def worker(state, phone, clocks, settings):
    """worker(): the chore that erases by age of a worker that starts now. A meal is there, sent today."""
    phone.post(pair())
    with state.database.write() as session:
        session.execute(sa.update(Study).values(retention_days=RETENTION_DAYS))

    def start():
        clock = TrustedClock(state.database, lambda: clocks.running)
        made = worker_chores(state.database, state.blobs, state.part(SecretBox), settings, clock)
        return next(chore for chore in made if chore.name == "erase_old_pictures").run

    return start


def pass_time(clocks, seconds):
    clocks.ahead += seconds
    clocks.running += seconds


def photographs(state):
    with state.database.read() as session:
        return session.scalar(sa.select(sa.func.count()).where(MealImage.erased_at.is_(None)))


@pytest.mark.both_stores
def test_worker_that_starts_with_a_wrong_clock_erases_nothing_until_it_has_run_for_a_day(worker, clocks, state):
    assert worker()() == 0
    clocks.ahead = 400 * DAY
    erase = worker()
    with capture_logs() as logs:
        assert erase() == 0
    assert [line["event"] for line in logs if line["log_level"] == "error"] == ["clock_doubted"]
    for _ in range(23):
        pass_time(clocks, HOUR)
        assert erase() == 0
    assert photographs(state) == 2
    pass_time(clocks, HOUR)
    with capture_logs() as logs:
        assert erase() == 1  # the clock was right: nobody was there for a year
    (line,) = [line for line in logs if line["event"] == "photographs_erased"]
    assert (line["photographs"], line["meals"]) == (2, 1)


def test_first_worker_of_an_upgrade_compares_its_clock_with_the_newest_event(worker, clocks, state):
    clocks.ahead = 400 * DAY
    assert worker()() == 0
    assert photographs(state) == 2


def test_clock_that_is_put_right_again_has_erased_nothing(worker, clocks, state):
    worker()()
    clocks.ahead = 400 * DAY
    erase = worker()
    erase()
    clocks.ahead = 0.0
    for _ in range(30):
        assert erase() == 0
        pass_time(clocks, HOUR)
    assert photographs(state) == 2


def test_quiet_study_is_erased_on_time(worker, clocks, state):
    erase = worker()
    for _ in range(RETENTION_DAYS * 2 - 1):
        assert erase() == 0
        pass_time(clocks, DAY / 2)
    assert erase() == 0
    pass_time(clocks, DAY / 2)
    assert erase() == 1


def test_day_of_waiting_is_no_shorter_for_two_workers(worker, clocks, state):
    worker()()
    clocks.ahead = 400 * DAY
    workers = worker(), worker()
    for hour in range(24):
        assert workers[hour % 2]() == 0
        pass_time(clocks, HOUR)
    assert photographs(state) == 2


def test_operator_says_that_the_clock_is_right(worker, clocks, state, settings, monkeypatch):
    worker()()
    clocks.ahead = 400 * DAY
    erase = worker()
    erase()
    monkeypatch.setenv("TADA_DATABASE_URL", settings.database_url)
    monkeypatch.setenv("TADA_DATA_DIR", str(settings.data_dir))
    assert "tada doctor --trust-clock" in finding_of_the_clock()["advice"]
    assert erase() == 0
    assert "--trust-clock" not in finding_of_the_clock("--trust-clock")["advice"]
    with state.database.read() as session:
        assert clock_doubted_seconds(session) == 0
    assert erase() == 1


def finding_of_the_clock(*options):
    printed = CliRunner().invoke(cli, ["doctor", "--json", *options]).stdout
    return next(each for each in json.loads(printed)["findings"] if each["subject"] == "clock")
