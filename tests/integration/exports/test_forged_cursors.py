"""Cursors are not signed: forged ones are handled by every list of the API's document."""

import base64
import json
import uuid

import pytest
import sqlalchemy as sa

from app.http import paging
from app.http.paging import encode_cursor
from app.meals.stored.job_models import Remeasurement
from app.outbox.models import Webhook
from app.people.models import Study
from tests.support.photographs import pair

KEYED_BY_TEXT = {  # any text is a place in such a list
    "/v1/staff",
    "/v1/studies",
    "/v1/studies/{study}/members",
    "/v1/studies/{study}/participants",
    "/v1/studies/{study}/intakes",
    "/v1/studies/{study}/vessels",
}
NO_FILTERS = {"limit", "cursor", "format", "layout", "components", "provenance"}  # the last three are of files
THERE = {"study": "pilot", "participant": "P001", "food": "apple"}  # one that is not is refused as such
ID = uuid.UUID(int=7)
NO_CURSORS = ("", "x", "%%%", "é", "\0", "=", "/" * 500, "e30", "W10")
NO_PAIRS = (None, True, 1, 1e400, float("nan"), "x", [], {}, ["key"], ["key", "right", "more"], [[["key"]], "right"])
NO_TEXTS = (None, True, 1, -1, 2**70, 1.5, float("nan"), float("inf"), [], ["key"], {"key": 1}, "a\0b", "\0", "\ud800")
PIECES = (  # more of them: tests/unit/http/test_cursors.py
    "", "x", "-1", "\u0661", str(2**63), "1e400", "nan", "2026-02-30", "2026-11-20T12:00:00",
    "0001-01-01T00:00:00+23:59", "10000-01-01T00:00:00+00:00", "record", str(ID), "1; DROP TABLE meal",
)  # fmt: skip
FORGED_KEYS = (
    *PIECES,
    *(f"{piece} {ID.hex}" for piece in PIECES),
    *(f"{good} {piece}" for good in ("0.5", "2026-11-20", "2026-11-20T12:00:00+00:00") for piece in PIECES),
    *("-1 record x", "7 x x", "7 record \u0661", "1 meal x", "a b c d", "  "),
)


def lists_of(client):
    """Path and operation of every list that takes a cursor."""
    return {
        path: operations["get"]
        for path, operations in client.app.openapi()["paths"].items()
        if any(each["name"] == "cursor" for each in operations.get("get", {}).get("parameters", ()))
    }


@pytest.fixture
def settings(settings):
    """Thousands of calls by one person in a minute."""
    return settings.model_copy(update={"staff_calls_per_minute": 0, "address_calls_per_minute": 0})


@pytest.fixture
def ask(client, state, enrol, admin):
    """Ask for a page of a list: ask(path, **query)."""
    phone = enrol()
    meal = phone.post(pair()).json()["id"]
    hook, remeasurement = uuid.uuid4(), uuid.uuid4()
    with state.database.write() as session:
        pilot = session.scalars(sa.select(Study)).one()
        common = {"study_id": pilot.id, "author": "admin", "created_at": pilot.created_at}
        session.add(Webhook(id=hook, url="https://example.org/", events=[], secret_sealed="x", **common))
        done = {"selection": "x", "state": "done", "pipeline_version": "x", "ended_at": pilot.created_at}
        session.add(Remeasurement(id=remeasurement, **done, **common))
    places = {"study": "pilot", "meal_id": meal, "webhook": hook, "remeasurement": remeasurement}

    def ask(path, **query):
        query |= {"participant": "P001"} if "{meal_id}" in path else {}
        return client.get(path.format(**places), headers=admin, params=query)

    return ask


def packed(value):
    return base64.urlsafe_b64encode(json.dumps(value).encode()).decode().rstrip("=")


def test_what_is_no_cursor_is_refused_by_every_list(client, ask, monkeypatch):
    monkeypatch.setattr(paging, "_fingerprint", lambda _: "right")
    forged = [*NO_CURSORS, *map(packed, NO_PAIRS), *(packed([text, "right"]) for text in NO_TEXTS)]
    forged += [packed(["key", fingerprint]) for fingerprint in (None, 1, [])]
    assert faults(["/v1/records"], ask, forged, may_be_a_place=()) == []
    some = ["%%%", packed(None), packed([[["key"]], "right"]), packed([None, "right"]), packed(["a\0b", "right"])]
    assert faults(lists_of(client), ask, some, may_be_a_place=()) == []


@pytest.mark.slow
def test_cursor_with_a_forged_key_is_refused_by_every_list_that_is_not_keyed_by_text(client, ask, monkeypatch):
    monkeypatch.setattr(paging, "_fingerprint", lambda _: "right")
    forged = [packed([key, "right"]) for key in FORGED_KEYS]
    assert faults(lists_of(client), ask, forged, may_be_a_place=KEYED_BY_TEXT) == []


def test_cursor_of_another_list_is_refused_by_every_list(client, ask):
    for path in lists_of(client):
        answer = ask(path, cursor=encode_cursor("another list", "key"))
        assert (path, answer.status_code, answer.json()["code"]) == (path, 422, "cursor_of_other_filters")


def test_cursor_of_every_list_binds_each_of_its_filters(client, ask, monkeypatch):
    asked = []
    monkeypatch.setattr(paging, "_fingerprint", lambda listed: asked.append(listed) or "")
    cursor = packed(["key", "right"])
    for path, operation in lists_of(client).items():
        ask(path, cursor=cursor)
        plain = asked[-1]
        for parameter in operation["parameters"]:
            if parameter["in"] != "query" or parameter["name"] in NO_FILTERS or "{meal_id}" in path:
                continue
            value = THERE.get(parameter["name"]) or something(parameter["schema"])
            answer = ask(path, cursor=cursor, **{parameter["name"]: value})
            assert answer.json()["code"] == "cursor_of_other_filters", (path, parameter["name"], answer.text)
            assert asked[-1] != plain, (path, parameter["name"])


def something(schema):
    """A value of a filter that is not its default."""
    schema = next((each for each in schema.get("anyOf", ()) if each.get("type") != "null"), schema)
    if schema.get("type") == "array":
        schema = schema["items"]
    if "enum" in schema:
        return schema["enum"][-1]
    by_format = {"uuid": str(ID), "date": "2026-11-20", "date-time": "2026-11-20T12:00:00Z"}
    by_type = {"integer": 3, "number": 0.5, "boolean": "true"}
    return by_format.get(schema.get("format")) or by_type.get(schema.get("type"), "pilot")


def faults(lists, ask, forged, *, may_be_a_place):
    """(path, cursor, answer) of those that were not refused as they should be."""
    found = []
    for path in lists:
        for cursor in forged:
            answer = ask(path, cursor=cursor)
            is_refused = answer.status_code == 422 and answer.json()["code"] in ("cursor_invalid", "invalid_input")
            if not (is_refused or (path in may_be_a_place and answer.status_code == 200)):
                found.append((path, cursor, answer.status_code, answer.text[:200]))
    return found
