"""Methods at addresses: HEAD is GET without a body, `Allow` is whole, a part of a body is not taken for the whole."""

import re
import uuid

from tests.integration.conftest import meal_metadata
from tests.support.photographs import pair, photograph

ANYTHING = {"study": "pilot", "day": "2026-11-21", "name": "left.jpg", "slot": "left", "key": "apple"}


def some_address(pattern):
    return re.sub(r"{(\w+)(?::\w+)?}", lambda found: ANYTHING.get(found[1], str(uuid.UUID(int=1))), pattern)


def test_refused_method_hears_of_all_that_the_address_takes(client):
    """26 addresses left out some."""
    addresses = {}
    for method, pattern in (call for call, rule in client.app.state.rules.items() if not rule.page):
        addresses.setdefault(some_address(pattern), set()).add(method)
    assert len(addresses) > 80
    for address, methods in addresses.items():
        answer = client.request("PROPFIND", address)
        assert (answer.status_code, answer.json().get("code")) in {(405, "method_not_allowed"), (405, None)}, address
        expected = methods | ({"HEAD"} if "GET" in methods else set())
        assert set(answer.headers["Allow"].split(", ")) == expected, address


PATHS = (
    "/v1/me",
    "/v1/meals",
    "/v1/meals/{meal}",
    "/v1/meals/{meal}/images/left?width=64",
    "/v1/meals/{meal}/images/right",
    "/v1/records",
    "/v1/records?format=csv",
    "/v1/foods?q=apple",
    "/v1/foods/apple",
    "/v1/nowhere",
    "/v1/records?limit=0",
    "/fhir/metadata",
    "/healthz",
    "/dashboard/sign-in",
)
CHANGING = {"ratelimit", "content-security-policy", "set-cookie", "x-request-id"}


def test_head_answers_as_get_without_the_body_and_is_refused_as_get_is(phone, client):
    body = meal_metadata()
    assert phone.post(pair(), body).status_code == 202
    for path in PATHS:
        address = path.format(meal=body["id"])
        got, head = (client.request(method, address, headers=phone.headers) for method in ("GET", "HEAD"))
        assert (head.status_code, head.content) == (got.status_code, b""), path
        headers = [{k: v for k, v in one.headers.items() if k not in CHANGING} for one in (got, head)]
        assert headers[0] == headers[1], path
    assert client.head("/v1/me").status_code == 401
    assert client.head("/v1/studies", headers=phone.headers).status_code == 403
    assert client.head("/v1/meals/" + str(uuid.uuid4()), headers=phone.headers).status_code == 404


def test_part_of_a_photograph_is_not_taken_for_the_whole(phone, client):
    meal = uuid.uuid4()
    assert client.put(f"/v1/meals/{meal}", headers=phone.headers, json=without_id(meal_metadata())).status_code == 202
    content = photograph()
    headers = phone.headers | {"Content-Type": "image/jpeg", "Content-Range": f"bytes 0-{len(content) - 1}/9999999"}
    refused = client.put(f"/v1/meals/{meal}/images/left", headers=headers, content=content)
    assert (refused.status_code, refused.json()["code"]) == (400, "content_range_refused")
    assert client.get(f"/v1/meals/{meal}", headers=phone.headers).json()["missing"] == ["left", "right"]


def test_answer_that_nothing_has_changed_has_no_length_however_the_etag_is_spelled(phone, client):
    body = meal_metadata()
    phone.post(pair(), body)
    for path in (f"/v1/meals/{body['id']}", f"/v1/meals/{body['id']}/images/left"):
        etag = client.get(path, headers=phone.headers).headers["ETag"]
        for known in (etag, f"W/{etag}", f'"other", {etag}', "*"):
            again = client.get(path, headers=phone.headers | {"If-None-Match": known})
            assert (again.status_code, again.content) == (304, b""), known
            assert "content-length" not in again.headers
            assert again.headers["ETag"] == etag


def without_id(metadata):
    return {name: value for name, value in metadata.items() if name != "id"}


def test_headers_of_a_body_mean_nothing_where_there_is_none(client, admin):
    headers = admin | {"Content-Range": "bytes 0-9/10", "Content-Encoding": "gzip"}
    assert client.get("/v1/studies", headers=headers).status_code == 200
