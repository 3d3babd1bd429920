"""The observer around a server: what it takes for a secret in an address."""

import pytest
from starlette.applications import Starlette
from starlette.responses import JSONResponse
from starlette.routing import Route
from starlette.testclient import TestClient

from app.extras.conformance.observer import Observer

TOKEN = "tada_" + "t" * 30


async def enrol(request):
    is_known = (await request.json())["code"] == "secret-code"
    return JSONResponse({"token": TOKEN} if is_known else {"code": "enrolment_code_invalid"}, 201 if is_known else 404)


async def me(_request):
    return JSONResponse({})


@pytest.mark.parametrize("code", ["v", None])
def test_code_that_enrols_nobody_is_no_secret_of_later_addresses(code):
    observer = Observer(Starlette(routes=[Route("/v1/enrolments", enrol, methods=["POST"]), Route("/v1/me", me)]))
    with TestClient(observer) as client:
        for each in (code, "secret-code"):
            client.post("/v1/enrolments", json={"code": each, "device_name": "phone"})
        for query in ("a=1", "code=secret-code"):
            client.get(f"/v1/me?{query}", headers={"Authorization": f"Bearer {TOKEN}"})
    (conversation,) = observer.conversations()
    assert [each.has_secret_in_url for each in conversation.exchanges] == [False, False, True]
