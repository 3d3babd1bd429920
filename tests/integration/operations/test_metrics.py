"""/metrics: who may read it, what it tells, and that a scrape neither hurts nor waits for a database that is away."""

import threading
import uuid
from datetime import UTC, datetime, timedelta

import pytest
import sqlalchemy as sa
import sqlalchemy.exc
from fastapi.testclient import TestClient
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_openmetrics
from prometheus_client.parser import text_string_to_metric_families
from pydantic import SecretStr

from app.exports.models import Export
from app.exports.release_models import Release, ReleaseChange
from app.operations import figures
from app.operations.figures import DeploymentFigures
from tests.integration.diary.eaten_days import add_meal, eaten_item
from tests.support.photographs import pair
from tests.support.waiting import PATIENCE_SECONDS, wait_until

TOKEN = "a token for tests of metrics"
HERE = {"Host": "127.0.0.1:8000"}


@pytest.fixture
def local(client):
    """The same app, called from this machine."""
    return TestClient(client.app, client=("127.0.0.1", 50000), headers=HERE)


@pytest.fixture
def settings(settings, request):
    token = getattr(request, "param", None)
    return settings.model_copy(update={"metrics_token": SecretStr(token) if token else None})


with_token = pytest.mark.parametrize("settings", [TOKEN], indirect=True, ids=["token"])


def samples(text):
    """(name, labels) -> value of all that a scrape told."""
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def scrape(local):
    answer = local.get("/metrics")
    assert answer.status_code == 200
    return samples(answer.text)


def value(found, name, **labels):
    return found.get((name, tuple(sorted(labels.items()))))


def test_caller_from_elsewhere_or_through_a_proxy_does_not_learn_that_there_are_metrics(client, local):
    answer = client.get("/metrics", headers=HERE)
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")
    forwarded = ("X-Forwarded-For", "Forwarded", "X-Real-IP", "Via", "X-Forwarded-Host", "X-Forwarded-Proto")
    for header in forwarded:
        assert local.get("/metrics", headers={header: "127.0.0.1"}).status_code == 404, header
    by_another_name = {"Host": "tada.example.org"}  # a page in a browser of this machine
    assert local.get("/metrics", headers=by_another_name).status_code == 404
    assert local.get("/metrics").status_code == 200


@with_token
def test_token_lets_in_from_anywhere_and_nothing_else_does(client, local):
    right = {"Authorization": f"Bearer {TOKEN}"}
    assert client.get("/metrics", headers=right).status_code == 200
    assert client.get("/metrics", headers=right | {"X-Forwarded-For": "198.51.100.7"}).status_code == 200
    for wrong in ({}, {"Authorization": f"Bearer {TOKEN}x"}, {"Authorization": f"Basic {TOKEN}"}):
        answer = local.get("/metrics", headers=wrong)
        assert (answer.status_code, answer.json()["code"]) == (401, "unauthenticated")


def test_uploads_are_counted_by_outcome_and_an_accepted_one_waits_in_the_queue(local, phone):
    before = scrape(local)
    assert value(before, "tada_jobs", state="queued") == 0
    assert value(before, "tada_queue_oldest_seconds") == 0
    photos = pair()
    meal_id = str(uuid.uuid4())
    assert phone.post(photos, id=meal_id).status_code == 202
    assert phone.post(photos, id=meal_id).status_code == 200
    assert phone.post(photos | {"left": b"\xff" * 500_000}).json()["code"] == "image_too_large"
    forget(local)
    after = scrape(local)
    for outcome in ("kept", "repeated", "image_too_large"):
        counts = [value(found, "tada_uploads_total", outcome=outcome) or 0 for found in (before, after)]
        assert counts[1] == counts[0] + 1
    received = value(after, "tada_http_received_bytes_total") - value(before, "tada_http_received_bytes_total")
    assert received > 2 * sum(len(photo) for photo in photos.values())
    assert value(after, "tada_jobs", state="queued") == 1
    assert value(after, "tada_meals", status="queued") == 1
    assert value(after, "tada_studies_waiting") == 1
    assert 0 < value(after, "tada_queue_oldest_seconds") < 10 * PATIENCE_SECONDS
    assert value(after, "tada_workers_alive") == 0
    assert value(after, "tada_database_up") == 1
    assert value(after, "tada_disk_free_bytes") > 0


def test_exports_and_releases_that_are_not_made_and_days_that_are_not_summed_are_told(
    local, client, admin, state, enrol
):
    enrol("P001")
    before = scrape(local)
    assert value(before, "tada_files_waiting", kind="export", state="queued") == 0
    assert value(before, "tada_files_oldest_seconds", kind="release") == 0
    assert value(before, "tada_releases_stuck") == 0
    client.post("/v1/studies/pilot/exports", headers=admin, json={"rows": "meals"}).raise_for_status()
    client.post("/v1/studies/pilot/releases", headers=admin, json={"name": "waits"}).raise_for_status()
    client.post("/v1/studies/pilot/releases", headers=admin, json={"name": "changes"}).raise_for_status()
    now = datetime.now(UTC)
    with state.database.write() as session:
        session.execute(sa.update(Export).values(requested_at=now - timedelta(minutes=2)))
        release = session.scalars(sa.select(Release).where(Release.name == "changes")).one()
        release.state, release.failure_code = "changing", "release_files_missing"
        release.requested_at = now - timedelta(days=90)  # frozen long ago, to be changed since an hour
        wanted = now - timedelta(hours=1)
        change = {"deed": "meal", "digest": "0" * 64, "requested_at": wanted}
        session.add(ReleaseChange(id=uuid.uuid4(), release_id=release.id, **change))
    add_meal(state, "P001", "2026-11-01", eaten_item(100.0))
    forget(local)
    after = scrape(local)
    for kind, of_state in (("export", {"queued": 1, "running": 0}), ("release", {"queued": 1, "changing": 1})):
        told = {state: value(after, "tada_files_waiting", kind=kind, state=state) for state in of_state}
        assert told == of_state
    assert value(after, "tada_files_oldest_seconds", kind="export") == pytest.approx(120, abs=60)
    assert value(after, "tada_files_oldest_seconds", kind="release") == pytest.approx(3600, abs=60)
    assert value(after, "tada_releases_stuck") == 1


def test_series_name_routes_and_never_what_was_sent_in_either_format(local, phone):
    strange = f"/v1/nothing/{uuid.uuid4()}"
    meal = uuid.uuid4()
    phone.get(strange)
    phone.get(f"/v1/meals/{meal}")
    local.request("BREW", "/v1/meals")
    text = local.get("/metrics").text
    assert 'route="/v1/meals/{meal_id}"' in text
    assert 'method="other"' in text
    for sent in (strange, str(meal), "BREW"):
        assert sent not in text
    answer = local.get("/metrics", headers={"Accept": "application/openmetrics-text; version=1.0.0"})
    assert answer.headers["content-type"].startswith("application/openmetrics-text")
    names = {family.name for family in parse_openmetrics(answer.text)}
    assert {"tada_build", "tada_http_request_seconds", "tada_database_up"} <= names


def test_call_that_waits_does_not_count_as_a_slow_one(local, phone):
    def answers(route):
        return value(scrape(local), "tada_http_answer_seconds_count", method="GET", route=route) or 0

    meal_id = str(uuid.uuid4())
    phone.post(pair(), id=meal_id)
    before = answers("/v1/meals/{meal_id}")
    phone.get(f"/v1/meals/{meal_id}", wait=0.1)
    assert answers("/v1/meals/{meal_id}") == before
    phone.get(f"/v1/meals/{meal_id}")
    assert answers("/v1/meals/{meal_id}") == before + 1


def test_database_that_is_away_costs_its_figures_and_not_the_scrape(local, monkeypatch):
    def away(_):
        raise sqlalchemy.exc.OperationalError("SELECT 1", None, ConnectionRefusedError())

    monkeypatch.setattr(figures, "figures", away)
    found = scrape(local)
    assert value(found, "tada_database_up") == 0
    assert value(found, "tada_jobs", state="queued") is None
    assert value(found, "tada_disk_free_bytes") > 0


def test_database_that_hangs_is_asked_by_one_thread_and_waited_for_a_moment_only(local, monkeypatch):
    go_on, asked = threading.Event(), []

    def hang(session):
        asked.append(1)
        assert go_on.wait(PATIENCE_SECONDS)
        return real(session)

    real = figures.figures
    monkeypatch.setattr(figures, "figures", hang)
    monkeypatch.setattr(figures, "PATIENCE_SECONDS", 0.05)
    try:
        assert [value(scrape(local), "tada_database_up") for _ in range(3)] == [0, 0, 0]
        wait_until(lambda: asked, "its thread to ask")
        assert asked == [1]
    finally:
        go_on.set()
    monkeypatch.setattr(figures, "PATIENCE_SECONDS", PATIENCE_SECONDS)
    assert value(scrape(local), "tada_database_up") == 1


def test_scrapes_ask_the_database_once_until_its_figures_are_too_old(local, monkeypatch):
    asked = []
    real = figures.figures
    monkeypatch.setattr(figures, "figures", lambda session: asked.append(1) or real(session))
    monkeypatch.setattr(figures, "CACHE_SECONDS", 10 * PATIENCE_SECONDS)  # however slow the machine is
    monkeypatch.setattr(figures, "PATIENCE_SECONDS", PATIENCE_SECONDS)
    for _ in range(3):
        scrape(local)
    assert asked == [1]
    part = local.app.state.api.part(DeploymentFigures)
    at, told = part._cached
    part._cached = (at - figures.CACHE_SECONDS, told)
    scrape(local)
    assert asked == [1, 1]


def forget(local):
    """The figures of a moment ago."""
    local.app.state.api.part(DeploymentFigures)._cached = None
