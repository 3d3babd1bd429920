"""Schemathesis against our own OpenAPI document: no call that it can think of gets an answer that is not declared."""

import os

import pytest
import schemathesis
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis import GenerationMode

from app.core.settings import Settings
from app.main import create_app
from app.people.access.staff import create_admin

schemathesis.serializer.alias("application/offset+octet-stream", "application/octet-stream")
EXAMPLES = int(os.environ.get("TADA_TEST_EXAMPLES", "8"))  # per operation, sign and role (docs/development.md)


@pytest.fixture(scope="module")
def live_app(tmp_path_factory):
    folder = tmp_path_factory.mktemp("schema")
    app = create_app(
        Settings(
            data_dir=folder,
            min_free_bytes=0,
            enrolment_attempts_per_minute=100_000,
            device_uploads_per_minute=0,
            device_calls_per_minute=0,
            staff_calls_per_minute=0,
            exports_per_minute=0,
            address_uploads_per_minute=0,
            address_calls_per_minute=0,
        )
    )
    with TestClient(app, raise_server_exceptions=False) as client:
        admin = {"Authorization": f"Bearer {create_admin(app.state.api.database, 'admin')}"}
        client.post("/v1/studies", headers=admin, json={"code": "s", "name": "s", "marker": "plain:9x7:11"})
        client.post("/v1/studies/s/participants", headers=admin, json={"code": "P1"})
        code = client.post("/v1/studies/s/participants/P1/enrolment-codes", headers=admin).json()["code"]
        token = client.post("/v1/enrolments", json={"code": code, "device_name": "phone"}).json()["token"]
        yield app, {"admin": admin, "device": {"Authorization": f"Bearer {token}"}}


# These end the phone's token, or the admin's: who comes after them hears of nothing else.
ENDS_THE_CALLER = frozenset({"post_my_withdrawal", "delete_my_device", "delete_current_session"})
# A call that the document allows may still be refused, for a reason that is not in it: no such study, too late.
NOT_ASKED = [schemathesis.checks.positive_data_acceptance]
# Wrong data may also be refused for their size (413): metadata of more than 64 KiB are not read.
REFUSALS = ["400", "401", "403", "404", "406", "413", "422", "428", "5xx"]

calls = settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)


@pytest.mark.slow
@pytest.mark.parametrize("role", ["admin", "device"])
@pytest.mark.parametrize("mode", list(GenerationMode))
def test_every_answer_is_one_that_the_document_declares(live_app, role, mode):
    app, headers = live_app
    schema = schemathesis.openapi.from_asgi("/openapi.json", app)
    schema.config.checks.negative_data_rejection.expected_statuses = REFUSALS
    operations = [found.ok() for found in schema.get_all_operations()]
    assert len(operations) >= 14
    for operation in operations:
        if mode is GenerationMode.NEGATIVE and not (list(operation.iter_parameters()) or operation.body):
            continue  # it takes nothing that could be wrong
        if operation.definition.raw["operationId"] in ENDS_THE_CALLER:
            continue

        @calls
        @given(case=operation.as_strategy(generation_mode=mode))
        def every_call_is_answered(case):
            if case.query and isinstance(case.query.get("wait"), (int, float)):
                case.query["wait"] = min(case.query["wait"], 0.01)  # it is meant to take its time
            answer = case.call(headers=headers[role])
            assert_no_server_error(answer)
            case.validate_response(answer, excluded_checks=NOT_ASKED)

        every_call_is_answered()


def assert_no_server_error(response):
    assert response.status_code < 500, response.text
    if response.status_code >= 400 and response.headers["content-type"] == ["application/fhir+json"]:
        assert response.json()["issue"][0]["details"]["coding"][0]["code"]
    elif response.status_code >= 400:
        assert response.headers["content-type"] == ["application/problem+json"]
        assert response.json()["code"]
