"""Small lists as CSV and NDJSON: the rows of their pages, safe for spreadsheets, with the same permissions."""

import csv
import io
import json
import uuid

from app.http import flat_list
from app.http.flat_list import ListRoute
from app.http.tables.flat_rows import flat_paths
from tests.integration.uploads.answers import refusal


def table(client, headers, path, output="csv", **params):
    answer = client.get(path, headers=headers, params=params | {"format": output})
    assert answer.status_code == 200, answer.text
    if output == "ndjson":
        return [json.loads(line) for line in answer.content.splitlines()]
    return list(csv.DictReader(io.StringIO(answer.text, newline="")))


def list_routes(app):
    """(path, its rows' model) of every list that leaves by the small mechanism."""
    found = {}
    pending = [app.router]
    while pending:
        for route in pending.pop().routes:
            if isinstance(route, ListRoute) and route._row is not None:
                found[route.path] = route._row
            inner = getattr(route, "original_router", None) or getattr(route, "router", None)
            if inner is not None:
                pending.append(inner)
    return found


def test_every_list_of_the_issue_leaves_as_a_table_whose_columns_differ(app):
    routes = list_routes(app)
    for path in (
        "/v1/studies", "/v1/staff", "/v1/tokens", "/v1/foods", "/v1/studies/{study}/participants",
        "/v1/studies/{study}/devices", "/v1/studies/{study}/members", "/v1/studies/{study}/densities",
        "/v1/studies/{study}/webhooks/{webhook}/deliveries", "/v1/studies/{study}/review-queue",
        "/v1/studies/{study}/intakes", "/v1/studies/{study}/adequacy",
    ):  # fmt: skip
        assert path in routes
    assert "/v1/days" not in routes  # written in another way
    for path, row in routes.items():
        names = ["_".join(one) for one in flat_paths(row)]
        assert len(set(names)) == len(names), path


def test_file_has_the_whole_list_however_long_its_pages(client, admin, enrol, monkeypatch):
    codes = [f"P{number}" for number in range(5)]
    for code in codes:
        enrol(code)
    path = "/v1/studies/pilot/participants"
    first = client.get(path, headers=admin, params={"format": "csv"})
    assert first.headers["ratelimit-policy"].startswith('"export"')
    assert uuid.UUID(first.headers["x-request-id"])
    assert [row["code"] for row in table(client, admin, path, limit=2)] == codes
    monkeypatch.setattr(ListRoute, "_greatest_limit", lambda _: 2)  # a file that is many pages
    assert [row["code"] for row in table(client, admin, path)] == codes
    monkeypatch.setattr(flat_list, "MOST_ROWS", 4)
    assert refusal(client.get(path, headers=admin, params={"format": "csv"})) == (422, "list_too_long")
    assert client.get(path, headers=admin, params={"format": "xlsx"}).status_code == 422


def test_nested_values_are_columns_and_null_is_an_empty_cell(client, admin, enrol):
    enrol("P001", after_window_minutes=90)
    study = table(client, admin, "/v1/studies")[0]
    told = client.get("/v1/studies/pilot", headers=admin).json()
    assert study["code"] == "pilot"
    assert study["after_window_minutes"] == "90"
    assert study["retention_days"] == ""
    assert table(client, admin, "/v1/studies", "ndjson")[0]["retention_days"] is None
    assert {*told} - {"camera"} <= set(study)
    assert study["camera_fx"] == ""


def test_empty_list_still_has_its_header(client, admin, enrol):
    enrol()
    answer = client.get("/v1/studies/pilot/densities?format=csv", headers=admin)
    assert answer.text.splitlines()[0].startswith("id,food,g_per_ml")
    assert client.get("/v1/studies/pilot/densities?format=ndjson", headers=admin).content == b""
