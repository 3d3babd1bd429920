"""Small lists as CSV and NDJSON: the rows of their pages, safe for spreadsheets, with the same permissions."""

import csv
import io
import json
import uuid

from app.http import flat_list
from app.http.flat_list import ListRoute
from tests.integration.meals.upload.answers import refusal


def table(client, headers, path, output="csv", **params):
    answer = client.get(path, headers=headers, params=params | {"format": output})
    assert answer.status_code == 200, answer.text
    if output == "ndjson":
        return [json.loads(line) for line in answer.content.splitlines()]
    return list(csv.DictReader(io.StringIO(answer.text, newline="")))


def test_file_has_the_whole_list_however_long_its_pages(client, admin, enrol, monkeypatch):
    codes = [f"P{number}" for number in range(5)]
    for code in reversed(codes):  # the newest phone is listed first
        enrol(code)
    path = "/v1/studies/pilot/devices"
    first = client.get(path, headers=admin, params={"format": "csv"})
    assert first.headers["ratelimit-policy"].startswith('"export"')
    assert uuid.UUID(first.headers["x-request-id"])
    assert [row["participant"] for row in table(client, admin, path, limit=2)] == codes
    monkeypatch.setattr(ListRoute, "_greatest_limit", lambda _: 2)  # a file that is many pages
    assert [row["participant"] for row in table(client, admin, path)] == codes
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
    assert {*told} - {"camera", "double_review"} <= set(study)
    assert (study["camera_fx"], study["double_review_share"]) == ("", "")


def test_empty_list_still_has_its_header(client, admin, enrol):
    enrol()
    answer = client.get("/v1/studies/pilot/densities?format=csv", headers=admin)
    assert answer.text.splitlines()[0].startswith("id,food,g_per_ml")
    assert client.get("/v1/studies/pilot/densities?format=ndjson", headers=admin).content == b""
