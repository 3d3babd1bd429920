"""A whole API on a throwaway database and store, without a worker; and a phone that is enrolled in it."""

import contextlib
import functools
import json
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from app.children.api_children import ApiChildren
from app.core.errors import ConflictError
from app.core.settings import Settings
from app.exports.releases.file_runner import FileRunner
from app.main import create_app
from app.people.access import passwords
from app.people.access.caller import authenticate, require_staff
from app.people.access.secret_box import SecretBox
from app.people.access.staff import create_admin
from app.people.devices import NewDevice, enrol_device, issue_enrolment_code
from app.people.participants import create_participant
from app.people.schemas import StudyIn
from app.people.studies import create_study
from app.people.studies_api import protocol_columns
from tests.integration.http.declared_answers import declared_answers
from tests.integration.kept_children import KeptChildren
from tests.support.commands import run_tada
from tests.support.next_migration import next_migration

__all__ = ["next_migration"]  # a fixture

STUDY_MARKER = "plain:9x7:11"
FULL_COST = {name: getattr(passwords, name) for name in ("MEMORY_KIB", "PASSES", "LANES")}


@pytest.fixture(scope="session", autouse=True)
def cheap_passwords() -> Iterator[None]:
    """Passwords hashed at the least cost: hundreds of tests sign somebody in, and few are about what it costs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(passwords, "MEMORY_KIB", 8)
        patch.setattr(passwords, "PASSES", 1)
        patch.setattr(passwords, "LANES", 1)
        yield


@pytest.fixture
def full_password_cost() -> Iterator[None]:
    """Passwords as the server hashes them; to be asked for before the client."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in FULL_COST.items():
            patch.setattr(passwords, name, value)
        yield


@pytest.fixture
def settings(prepared_database_url, blob_settings, tmp_path) -> Settings:
    return Settings(
        data_dir=tmp_path / "data",
        database_url=prepared_database_url,
        max_photo_bytes=400_000,
        max_photo_pixels=3_000_000,
        min_free_bytes=0,
        secret_key="a key for tests only, of no worth",
        enrolment_attempts_per_minute=60,
        **blob_settings,
    )


@pytest.fixture(scope="session")
def app() -> FastAPI:
    """The app, whose hundred routes are made once; each test opens it with settings of its own."""
    return create_app(Settings())


@pytest.fixture(scope="module")
def require_declared(app):
    """Raises for an answer that the OpenAPI document does not declare: see declared_answers.py."""
    return _require_declared(app)


@functools.cache
def _require_declared(app):
    return declared_answers(app.openapi())


@pytest.fixture(scope="session")
def kept_children() -> Iterator[KeptChildren]:
    kept = KeptChildren()
    yield kept
    kept.close()


@pytest.fixture(autouse=True)
def reuse_children(kept_children) -> Iterator[None]:
    """Have pools take over the children of pools that ended without work: see kept_children.py."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("app.children.child_pool._Child", kept_children.start)
        yield


@pytest.fixture
def client(app, settings, require_declared) -> Iterator[TestClient]:
    """The app on a database that is prepared already; its children start when a test needs one."""
    settings.data_dir.mkdir(parents=True)
    app.state.settings = settings
    client = TestClient(app, raise_server_exceptions=False)
    client.event_hooks = {"response": [require_declared]}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("app.main.prepare_patiently", lambda *_, **__: None)
        patch.setattr(ApiChildren, "start_soon", lambda _: None)
        client.__enter__()
    try:
        yield client
    finally:
        client.__exit__(None, None, None)


@pytest.fixture
def state(client):
    return client.app.state.api


@pytest.fixture
def admin(state) -> dict[str, str]:
    """An admin's header."""
    return {"Authorization": f"Bearer {create_admin(state.database, 'admin')}"}


@dataclass(frozen=True)
class Phone:
    """An enrolled phone: sends meals and asks for them."""

    client: TestClient
    headers: dict[str, str]

    def post(self, photos, metadata=None, **changes):
        body = metadata if metadata is not None else meal_metadata(**changes)
        files = {"metadata": ("m.json", body if isinstance(body, bytes) else json.dumps(body), "application/json")}
        files |= {slot: (f"{slot}.jpg", content, "image/jpeg") for slot, content in photos.items()}
        return self.client.post("/v1/meals", headers=self.headers, files=files)

    def get(self, path, **params):
        return self.client.get(path, headers=self.headers, params=params)

    def put(self, path, **arguments):
        headers = self.headers | arguments.pop("headers", {})
        return self.client.put(path, headers=headers, **arguments)


def meal_metadata(**changes):
    """Good metadata; a change to None leaves the field out."""
    body = {
        "id": str(uuid.uuid4()),
        "captured_at": "2026-11-20T12:30:00+08:00",
        "time_zone": "Asia/Shanghai",
    }
    return {key: value for key, value in (body | changes).items() if value is not None}


@pytest.fixture
def enrol(client, state, admin):
    """Enrol a phone of a participant: enrol("P001"); study and participant are made when needed.

    By the services that the calls ask: a tenth of the calls' time; the calls have tests of their own.
    """
    database, box = state.database, state.part(SecretBox)
    caller = require_staff(authenticate(database, box, admin["Authorization"].removeprefix("Bearer ")))

    def enrol(participant="P001", study="pilot", **study_fields):
        body = StudyIn.model_validate({"code": study, "name": study, "marker": STUDY_MARKER} | study_fields)
        with contextlib.suppress(ConflictError):
            create_study(database, code=study, name=body.name, caller=caller, protocol=protocol_columns(body))
        with contextlib.suppress(ConflictError):
            create_participant(database, box, study_code=study, code=participant, caller=caller)
        issued = issue_enrolment_code(database, study_code=study, participant_code=participant, caller=caller)
        enrolled = enrol_device(database, box, code=issued.code, device=NewDevice("test phone"))
        return Phone(client, {"Authorization": f"Bearer {enrolled.token}"})

    return enrol


@pytest.fixture
def tada(settings, client):
    """Commands on the server's own database."""
    places = {"TADA_DATABASE_URL": settings.database_url, "TADA_DATA_DIR": settings.data_dir}
    return partial(run_tada, **places, TADA_SECRET_KEY=settings.secret_key.get_secret_value())


@pytest.fixture
def run(state):
    """Make the next export or release, as a worker's side process does."""

    def run():
        return FileRunner(state.database, state.blobs, state.settings, state.part(SecretBox), uuid.uuid4()).run_one()

    return run


@pytest.fixture
def phone(enrol) -> Phone:
    return enrol()
