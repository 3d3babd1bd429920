"""A real server on throwaway data for browsers to look at: studies, staff, phones, meals with made-up estimates."""

import json
import pathlib
import uuid
from dataclasses import dataclass
from functools import cached_property

import httpx2

from app.db.session import Database
from app.storage.local import LocalBlobStore
from tests.e2e.processes import Server
from tests.support import estimates
from tests.support.photographs import pair
from tests.support.waiting import PATIENCE_SECONDS

PASSWORD = "correct horse battery"
NO_LIMITS = {
    f"TADA_{who}_PER_MINUTE": "0"
    for who in ("DEVICE_UPLOADS", "DEVICE_CALLS", "ADDRESS_UPLOADS", "ADDRESS_CALLS", "STAFF_CALLS")
}


@dataclass
class DashboardServer:
    """The server, and the database beside it for what only a worker does."""

    server: Server
    database: Database
    admin: httpx2.Client

    @property
    def address(self) -> str:
        return self.server.address

    @cached_property
    def blobs(self) -> LocalBlobStore:
        """The store beside it, likewise."""
        return LocalBlobStore(self.server.data_dir / "blobs")

    def make_study(self, code="pilot", name="Pilot study", **fields):
        body = {"code": code, "name": name, "marker": "plain:9x7:11"} | fields
        require(self.admin.post("/v1/studies", json=body))

    def make_staff(self, name, **roles):
        """Somebody who signs in with PASSWORD, with roles by study."""
        require(self.admin.post("/v1/staff", json={"name": name, "password": PASSWORD}))
        for study, role in roles.items():
            require(self.admin.put(f"/v1/studies/{study}/members/{name}", json={"role": role}))

    def enrol(self, participant="P001", study="pilot") -> httpx2.Client:
        """A phone that is enrolled."""
        people = f"/v1/studies/{study}/participants"
        require(self.admin.post(people, json={"code": participant}))
        code = require(self.admin.post(f"{people}/{participant}/enrolment-codes"))["code"]
        token = require(self.admin.post("/v1/enrolments", json={"code": code, "device_name": "phone"}))["token"]
        return httpx2.Client(
            base_url=self.address, headers={"Authorization": f"Bearer {token}"}, timeout=PATIENCE_SECONDS
        )

    def send_meal(self, phone, *items, photos=None, **metadata):
        """A meal with these items as its estimate (tests/support/estimates.py): its id."""
        body = {
            "id": str(uuid.uuid4()),
            "captured_at": "2026-11-20T12:30:00+08:00",
            "time_zone": "Asia/Shanghai",
        } | metadata
        files = {"metadata": ("m.json", json.dumps(body), "application/json")}
        files |= {slot: (f"{slot}.jpg", content, "image/jpeg") for slot, content in (photos or pair()).items()}
        require(phone.post("/v1/meals", files=files))
        if items:
            estimates.save(self, body["id"], *items)
        return body["id"]

    def say(self, meal, kind, **fields):
        """An event of the admin's about a meal."""
        tag = self.admin.get(f"/v1/meals/{meal}").headers["etag"]
        body = {"id": str(uuid.uuid4()), "kind": kind} | fields
        return require(self.admin.post(f"/v1/meals/{meal}/events", headers={"If-Match": tag}, json=body))

    def meal(self, meal):
        return require(self.admin.get(f"/v1/meals/{meal}"))

    def close(self):
        self.admin.close()
        self.database.dispose()
        self.server.stop()


def dashboard_server(folder: pathlib.Path, **variables: str) -> DashboardServer:
    """A server without a worker on the embedded database, with an admin; to be closed."""
    server = Server(
        folder,
        "--no-worker",
        TADA_SIGN_IN_ATTEMPTS_PER_MINUTE="1000",
        TADA_ENROLMENT_ATTEMPTS_PER_MINUTE="1000",
        TADA_MIN_FREE_BYTES="0",
        **NO_LIMITS,
        **variables,
    )
    server.place_prepared_database()
    server.start()
    try:
        server.wait_until_ready()
        token = server.create_admin("boss")
    except BaseException:
        server.stop()
        raise
    client = httpx2.Client(
        base_url=server.address, headers={"Authorization": f"Bearer {token}"}, timeout=PATIENCE_SECONDS
    )
    return DashboardServer(server, Database(server.database_url), client)


def require(answer):
    """The body of an answer that must be good."""
    assert answer.status_code < 300, (answer.request.url.path, answer.status_code, answer.text)
    return answer.json() if answer.content else None
