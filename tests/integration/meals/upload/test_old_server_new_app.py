"""An app that is newer than the server, or older: it can ask what the server knows, and loses no meal by the rest."""

from datetime import UTC, datetime, timedelta

import sqlalchemy as sa

from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.support import estimates
from tests.support.estimates import found_item
from tests.support.photographs import pair


def test_app_learns_what_the_server_can_do_before_it_has_a_token(client, settings):
    told = client.get("/v1/server").json()
    assert told["api_versions"] == ["v1"]
    assert {"captured_at", "time_zone", "hints", "complete"} <= set(told["metadata_fields"])
    assert {"point", "box", "polygon", "food"} <= set(told["hint_fields"])
    assert told["limits"]["photo_bytes"] == settings.max_photo_bytes
    assert "image/jpeg" in told["image_types"]
    assert abs(datetime.fromisoformat(told["time"]) - datetime.now(UTC)) < timedelta(minutes=1)


def test_field_that_the_server_does_not_know_is_kept_aside_and_told(phone, state, client):
    hints = [{"point": [30, 20], "food": "apple", "chewed": True}]
    new = meal_metadata(hints=hints, mood="\x00 happy", depth={"unit": "mm", "max": 1e300})
    sent = phone.post(pair(), new)
    assert sent.status_code == 202, sent.text
    assert sent.json()["ignored"] == ["depth", "hints.0.chewed", "mood"]
    assert phone.get(f"/v1/meals/{new['id']}").json()["ignored"] == ["depth", "hints.0.chewed", "mood"]
    with state.database.read() as session:
        details = session.scalars(sa.select(Meal)).one().details
    assert details["hints"] == [{"point": [30.0, 20.0], "food": "apple"}]
    assert '"max": 1e+300' in details["unknown"]
    assert phone.post(pair(), new).status_code == 200
    updated = {name: value for name, value in new.items() if name not in {"mood", "depth"}}
    assert phone.post(pair(), updated).status_code == 200  # the app was replaced while the meal waited


def test_field_of_the_after_meal_pair_that_is_not_known_is_kept_aside(phone, client, state):
    body = meal_metadata()
    phone.post(pair(), body)
    estimates.save(state, body["id"], found_item(hint=None))
    told = {"captured_at": "2026-11-20T13:00:00+08:00", "mood": "full"}
    answer = client.put(f"/v1/meals/{body['id']}/after", headers=phone.headers, json=told)
    assert (answer.status_code, answer.json()["after"]["ignored"]) == (202, ["mood"])
    assert client.put(f"/v1/meals/{body['id']}/after", headers=phone.headers, json=told).status_code == 200


def test_parameter_that_is_not_known_or_given_twice_is_refused_and_a_list_is_not(phone, client, monkeypatch):
    for path in ("/v1/records?studdy=pilot", "/v1/meals?limit=2&page=3", "/v1/me?verbose=1", "/v1/foods?q=a&=1"):
        answer = client.get(path, headers=phone.headers)
        assert refusal(answer) == (422, "parameter_unknown"), path
        assert len(answer.json()["parameters"]) == 1
    assert client.get("/v1/records?studdy=pilot").status_code == 401
    answer = client.get("/v1/meals?status=estimated&status=failed&limit=2&limit=3", headers=phone.headers)
    assert (*refusal(answer), answer.json()["parameters"]) == (422, "parameter_repeated", ["limit"])
    monkeypatch.setattr(client.app, "openapi_schema", None)  # they are checked without the document
    monkeypatch.setattr(client.app, "openapi", None)
    assert client.get("/v1/meals?status=estimated&status=failed", headers=phone.headers).status_code == 200


def test_meal_of_a_clock_that_may_be_wrong_is_flagged(phone, state):
    """A clock a year behind filed meals under last year without a word."""
    doubtful = ["clock_doubtful"]
    for delay, flags in (
        (timedelta(days=365), doubtful),
        (timedelta(days=59), []),
        (timedelta(minutes=-5), []),
        (timedelta(hours=-3), doubtful),
    ):
        captured_at = (datetime.now(UTC) - delay).isoformat(timespec="seconds")
        body = meal_metadata(captured_at=captured_at, time_zone="UTC")
        sent = phone.post(pair(), body)
        assert (sent.status_code, sent.json()["flags"]) == (202, flags)
    estimates.save(state, body["id"], found_item(hint=None))
    with state.database.read() as session:
        assert session.scalars(sa.select(EffectiveRecord)).one().flags == doubtful
