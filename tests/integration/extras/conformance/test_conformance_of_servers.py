"""`tada conformance run`: our server passes each check, and a server that does it wrong fails it."""

import uuid

import httpx2
import pytest

from app.extras.conformance import server_checks
from app.extras.conformance.server_checks import CHECKS
from app.extras.conformance.server_phone import TrialPhone, enrol
from app.extras.conformance.verdict import name_of
from tests.support.estimates import found_item, save
from tests.support.photographs import pair

BY_NAME = {name_of(check): check for check in CHECKS}


class Line:
    """A client whose answers a lie may change, as another server would give them."""

    def __init__(self, client):
        self._client = client
        self.lie = lambda request, answer: answer

    def request(self, method, path, **arguments):
        answer = self._client.request(method, path, **arguments)
        return self.lie((method, path.partition("?")[0]), answer)

    def get(self, path, **arguments):
        return self.request("GET", path, **arguments)

    def post(self, path, **arguments):
        return self.request("POST", path, **arguments)


class InProcessPhone(TrialPhone):
    """A phone whose lost requests do not arrive, and whose lost answers are not read."""

    def lose_answer(self, method, path, body, content_type):
        self.call(method, path, content=body, headers={"Content-Type": content_type})

    def lose_request(self, method, path, body, content_type):
        pass


def changed(answer, status=None, drop=(), **fields):
    """An answer with another status, without some fields and headers, and with other fields."""
    body = {**answer.json(), **fields} if answer.content else {}
    headers = {name: value for name, value in answer.headers.items() if name not in {"content-length", *drop}}
    body = {name: value for name, value in body.items() if name not in drop}
    return httpx2.Response(status or answer.status_code, headers=headers, json=body)


@pytest.fixture
def trial(client, admin, state, monkeypatch):
    monkeypatch.setattr(server_checks, "SETTLE_SECONDS", 0.0)
    monkeypatch.setattr(server_checks, "ESTIMATE_SECONDS", 0.05)
    monkeypatch.setattr(server_checks, "WAIT_SECONDS", 0.1)
    client.post(
        "/v1/studies", headers=admin, json={"code": "try", "name": "t", "marker": "plain:9x7:11", "sandbox": True}
    )
    client.post("/v1/studies/try/participants", headers=admin, json={"code": "P001"})
    code = client.post("/v1/studies/try/participants/P001/enrolment-codes", headers=admin).json()["code"]
    line = Line(client)
    _, phone = enrol(line, code, pair())
    assert phone is not None
    return InProcessPhone(line, phone.token, phone.pair)


def run_checks(state, phone, until=None):
    """Make the checks up to one of them; the worker's part is done in between. Returns the outcomes."""
    outcomes = {}
    for name, check in BY_NAME.items():
        if name == "estimate":
            phone.put_photograph("right")
            save(state, phone.meal, found_item(hint=None))
        outcomes[name] = check(phone)
        if name == until:
            break
    return outcomes


def test_our_server_passes_every_check(state, trial):
    outcomes = run_checks(state, trial)
    assert {name: verdict.outcome for name, verdict in outcomes.items()} == dict.fromkeys(outcomes, "passed"), outcomes
    assert list(outcomes) == list(BY_NAME)


def on(method, end, **changes):
    """A lie about the answers of calls whose path ends so."""

    def lie(request, answer):
        is_meant = request[0] == method and request[1].endswith(end) and answer.status_code != 304
        return changed(answer, **changes) if is_meant else answer

    return lie


def accepts_anything(request, answer):
    return changed(answer, status=202) if request[0] in {"PUT", "POST"} and answer.status_code >= 400 else answer


def loses_conditions(request, answer):
    return httpx2.Response(200, json={}) if answer.status_code == 304 else answer


def counts_twice(request, answer):
    if request[1].endswith("/events") and answer.status_code == 200:
        return changed(answer, version=uuid.uuid4().int)
    return answer


LIES = [
    ("problems", on("GET", "/v1/me", drop=("retryable",))),
    ("problems", on("GET", "/v1/meals", status=200)),
    ("lost_answer", on("PUT", "", status=409)),
    ("lost_answer", on("PUT", "", status=202)),
    ("ids", accepts_anything),
    ("broken_upload", on("GET", "", missing=[])),
    ("broken_upload", on("PUT", "/left", images={"left": {"durable": False}})),
    ("broken_upload", on("PUT", "/left", images={"left": {"durable": True, "received_sha256": "0" * 64}})),
    ("repeated_photograph", on("PUT", "/left", status=202)),
    (
        "repeated_photograph",
        lambda request, answer: changed(answer, status=200) if request[1].endswith("/left") else answer,
    ),
    ("unknown_fields", on("PUT", "", status=422)),
    ("unknown_fields", on("PUT", "", ignored=[])),
    ("time_zones", accepts_anything),
    ("whole_meal", on("POST", "/v1/meals", status=202)),
    ("estimate", on("PUT", "/right", missing=["left"])),
    ("estimate", on("GET", "", drop=("status",))),
    ("conditional_reading", loses_conditions),
    ("conditional_reading", on("GET", "", drop=("etag",))),
    ("changes", accepts_anything),
    ("changes", counts_twice),
    (
        "pieces",
        lambda request, answer: (
            httpx2.Response(200, headers={"upload-offset": "0"}) if request[0] == "HEAD" else answer
        ),
    ),
    ("deletion", on("DELETE", "", status=500)),
    ("deletion", accepts_anything),
    ("withdrawal", on("POST", "/withdrawal", drop=("id",))),
    ("withdrawal", on("GET", "/v1/me", status=200)),
]


@pytest.mark.parametrize(("name", "lie"), LIES)
def test_server_that_does_it_wrong_fails(state, trial, name, lie):
    names = list(BY_NAME)
    if names.index(name):
        run_checks(state, trial, until=names[names.index(name) - 1])
    trial.client.lie = lie
    if name == "estimate":
        trial.put_photograph("right")
        save(state, trial.meal, found_item(hint=None))
    assert BY_NAME[name](trial).outcome == "failed"


@pytest.mark.parametrize("fields", [{"images": []}, {"missing": 5}])
def test_answers_of_another_form_fail_their_check_and_do_not_end_the_kit(trial, fields):
    trial.client.lie = lambda request, answer: (
        changed(answer, **fields) if request[0] in {"GET", "PUT"} and answer.status_code in {200, 202} else answer
    )
    outcomes = {result.name: result.verdict.outcome for result in server_checks.try_server(trial)}
    assert list(outcomes) == list(BY_NAME)
    assert outcomes["broken_upload"] == "failed"
    assert outcomes["withdrawal"] == "passed"


def test_every_check_is_failed_by_some_server():
    assert {name for name, _ in LIES} == set(BY_NAME)
