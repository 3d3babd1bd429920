"""Every changing call leaves an event in the audit log: a new route needs a call here, or a reason why not."""

import base64
import json
import uuid

import pytest
import sqlalchemy as sa

from app.extras.reminders.web_push import text_of
from app.people.access.access_rules import SAFE_METHODS
from app.people.privacy_models import AuditEvent
from app.webhooks import safe_address
from tests.integration.conftest import meal_metadata
from tests.integration.foods.editing import QUARK
from tests.integration.people.people import PASSWORD, make_staff
from tests.support import estimates
from tests.support.estimates import found_item
from tests.support.photographs import pair
from tests.support.push_services import Browser
from tests.unit.vision.test_rig import FILE as RIG_FILE

IMAGE = "/v1/meals/{meal_id}/images/{slot}"
UNNOTED = {
    ("POST", "/v1/checks"): "judges a pair and keeps nothing",
    ("POST", "/v1/barcodes"): "reads a barcode and keeps nothing",
    (
        "POST",
        "/v1/calibrations",
    ): "noted, as tests/integration/meals/upload/test_calibrations.py shows: it needs photographs of a board",
    ("POST", "/v1/calibrations/{calibration_id}/withdrawal"): "the same",
    ("POST", f"{IMAGE}/upload"): "keeps nothing of the study's: bytes that are not yet a photograph",
    ("PATCH", f"{IMAGE}/upload"): "the same; its last byte is noted as PUT is, as test_partial_uploads.py shows",
    ("DELETE", f"{IMAGE}/upload"): "removes such bytes",
}
STUDY = {"study": "pilot"}
PARTICIPANTS = "/v1/studies/{study}/participants"
HOOKS = "/v1/studies/{study}/webhooks"
VESSELS = "/v1/studies/{study}/vessels"
AGAIN = "/v1/studies/{study}/remeasurements"
ANY_VERSION = {"If-Match": "*"}


@pytest.fixture(autouse=True)
def every_name_is_public(monkeypatch):
    monkeypatch.setattr(safe_address, "system_resolver", lambda *_: ["8.8.8.8"])


class Walk:
    """Calls, each of which must be noted."""

    def __init__(self, client, state):
        self.client, self.state = client, state
        self.done, self.unnoted = set(), []

    def events(self):
        with self.state.database.read() as session:
            return session.scalar(sa.select(sa.func.count()).select_from(AuditEvent))

    def __call__(self, headers, method, route, body=None, *, extra=None, files=None, content=None, **path):
        before = self.events()
        answer = self.client.request(
            method, route.format(**path), headers=headers | (extra or {}), json=body, files=files, content=content
        )
        assert answer.status_code < 400, (method, route, answer.text)
        self.done.add((method, route))
        if self.events() == before:
            self.unnoted.append((method, route))
        return answer


def test_every_changing_call_is_noted(client, state, admin, enrol):
    walk = Walk(client, state)
    walk(admin, "POST", "/v1/studies", {"code": "pilot", "name": "pilot", "marker": "plain:9x7:11"})
    walk(admin, "PATCH", "/v1/studies/{study}", {"expects_after_pair": True}, extra=ANY_VERSION, **STUDY)
    phone = enrol("P001").headers
    call_of_staff(walk, client, admin)
    call_of_people(walk, client, admin)
    walk(enrol("P003").headers, "DELETE", "/v1/me/device")
    call_of_meals(walk, state, admin, phone)
    call_of_webhooks(walk, admin)
    call_of_foods(walk, admin)
    call_of_vessels(walk, admin)
    walk(phone, "PUT", "/v1/me/favourites", {"items": []})
    call_of_known_items(walk, admin)
    reference = {"content": b"participant,local_date\n", "extra": {"Content-Type": "text/csv"}}
    walk(admin, "PUT", "/v1/studies/{study}/reference-days", **reference, **STUDY)
    walk(phone, "POST", "/v1/rigs", RIG_FILE)
    walk(admin, "POST", "/v1/studies/{study}/rigs", RIG_FILE, **STUDY)
    call_of_remeasurements(walk, admin)
    export = walk(admin, "POST", "/v1/studies/{study}/exports", {"rows": "days"}, **STUDY).json()
    walk(admin, "DELETE", "/v1/studies/{study}/exports/{export_id}", export_id=export["id"], **STUDY)
    walk(admin, "POST", "/v1/studies/{study}/releases", {"name": "baseline"}, **STUDY)
    walk(admin, "POST", PARTICIPANTS + "/{participant}/withdrawal", participant="P002", **STUDY)
    walk(phone, "POST", "/v1/me/withdrawal")
    # pages change by the services that the calls of the API have: those note it
    rules = client.app.state.rules
    changing = {route for route, rule in rules.items() if route[0] not in SAFE_METHODS and not rule.page}
    assert walk.unnoted == []
    assert changing - walk.done == set(UNNOTED)


def call_of_staff(walk, client, admin):
    for name in ("keller", "huber"):
        walk(admin, "POST", "/v1/staff", {"name": name, "password": PASSWORD})
        walk(admin, "PUT", "/v1/studies/{study}/members/{name}", {"role": "owner"}, name=name, **STUDY)
    walk(admin, "DELETE", "/v1/studies/{study}/members/{name}", name="huber", **STUDY)
    walk(admin, "PATCH", "/v1/staff/{name}", {"is_admin": True}, name="keller")
    token = walk({}, "POST", "/v1/sessions", {"name": "keller", "password": PASSWORD}).json()["token"]
    keller = {"Authorization": f"Bearer {token}"}
    made = walk(keller, "POST", "/v1/tokens", {"name": "export"}).json()
    walk(keller, "DELETE", "/v1/tokens/{token_id}", token_id=made["id"])
    other_password = {"current_password": PASSWORD, "new_password": "quite another battery"}
    walk(keller, "POST", "/v1/sessions/current/password", other_password)
    walk(make_staff(client, admin, "weber").headers, "DELETE", "/v1/sessions/current")


@pytest.fixture
def settings(settings):
    """A server that sends reminders."""
    return settings.model_copy(update={"push_contact": "mailto:study@example.org"})


def call_of_people(walk, client, admin):
    walk(admin, "POST", PARTICIPANTS, {"code": "P002"}, **STUDY)
    one = {"participant": "P002"} | STUDY
    walk(admin, "PATCH", PARTICIPANTS + "/{participant}", {"profile": {"sex": "male"}}, **one)
    code = walk(admin, "POST", PARTICIPANTS + "/{participant}/enrolment-codes", **one).json()["code"]
    walk({}, "POST", "/v1/enrolments", {"code": code, "device_name": "phone"})
    listed = client.get("/v1/studies/pilot/devices", headers=admin).json()["items"]
    device = next(row["id"] for row in listed if row["participant"] == "P002")
    walk(admin, "DELETE", "/v1/studies/{study}/devices/{device_id}", device_id=device, **STUDY)


def call_of_meals(walk, state, admin, phone):
    receiver = Browser().receiver
    keys = {"p256dh": text_of(receiver.public_key), "auth": text_of(receiver.auth)}
    subscription = {"endpoint": "https://push.example.org/a", "keys": keys}
    walk(phone, "PUT", "/v1/me/reminders", {"subscription": subscription, "time_zone": "Europe/Berlin"})
    walk(admin, "POST", "/v1/studies/{study}/reminders", {"participants": ["P001"]}, **STUDY)
    walk(phone, "DELETE", "/v1/me/reminders")
    body = meal_metadata(hints=[{"point": [30, 20], "food": "apple"}])
    one = {"meal_id": body["id"]}
    walk(phone, "PUT", "/v1/meals/{meal_id}", {k: v for k, v in body.items() if k != "id"}, **one)
    for slot, content in pair(1).items():
        walk(phone, "PUT", "/v1/meals/{meal_id}/images/{slot}", content=content, slot=slot, **one)
    estimates.save(state, body["id"], found_item(hint=0))
    walk(phone, "PUT", "/v1/meals/{meal_id}/after", {"captured_at": "2026-11-20T13:00:00+08:00"}, **one)
    said = {"id": str(uuid.uuid4()), "kind": "comment", "text": "cold"}
    walk(phone, "POST", "/v1/meals/{meal_id}/events", said, extra=ANY_VERSION, **one)
    walk(phone, "DELETE", "/v1/meals/{meal_id}", **one)
    files = {"metadata": ("m.json", json.dumps(meal_metadata()), "application/json")}
    files |= {slot: (slot, content, "image/jpeg") for slot, content in pair(2).items()}
    waiting = {"meal_id": walk(phone, "POST", "/v1/meals", files=files).json()["id"]}
    walk(phone, "POST", "/v1/meals/{meal_id}/cancel", **waiting)
    walk(admin, "POST", "/v1/meals/{meal_id}/retry", **waiting)
    walk(phone, "POST", "/v1/declared-meals", meal_metadata(items=[{"food": "apple"}]))
    closed = {"status": "closed"}
    walk(phone, "PUT", "/v1/me/days/{day}", closed, extra=ANY_VERSION, day="2026-11-18")
    day = {"participant": "P001", "day": "2026-11-17"} | STUDY
    walk(admin, "PUT", PARTICIPANTS + "/{participant}/days/{day}", closed, extra=ANY_VERSION, **day)


def call_of_webhooks(walk, admin):
    hook = {"url": "https://hooks.example.org/a", "events": ["*"]}
    made = walk(admin, "POST", HOOKS, hook, **STUDY).json()["webhook"]
    one = {"webhook": made["id"]} | STUDY
    walk(admin, "PATCH", HOOKS + "/{webhook}", {"events": ["meal.failed"]}, extra=ANY_VERSION, **one)
    walk(admin, "POST", HOOKS + "/{webhook}/secret", **one)
    delivery = walk(admin, "POST", HOOKS + "/{webhook}/test", **one).json()["id"]
    walk(admin, "POST", HOOKS + "/{webhook}/deliveries/{delivery}/replay", delivery=delivery, **one)
    walk(admin, "DELETE", HOOKS + "/{webhook}", **one)


def call_of_remeasurements(walk, admin):
    one = {"remeasurement": walk(admin, "POST", AGAIN, {}, **STUDY).json()["id"]} | STUDY
    for deed in ("stop", "continue"):
        walk(admin, "POST", AGAIN + "/{remeasurement}/" + deed, **one)


def call_of_vessels(walk, admin):
    measures = {"kind": "mug", "rim_diameter_mm": 82, "height_mm": 95, "capacity_ml": 400}
    made = walk(admin, "POST", VESSELS, measures | {"name": "Blue mug"}, **STUDY).json()
    one = {"vessel": made["id"]} | STUDY
    walk(admin, "PUT", VESSELS + "/{vessel}", measures | {"capacity_ml": 410}, extra=ANY_VERSION, **one)
    walk(admin, "DELETE", VESSELS + "/{vessel}", **one)


def call_of_known_items(walk, admin):
    item = {"food": "apple", "mass_g": 90, "shown_g": 80, "polygon": [[9, 9], [40, 9], [9, 40]]}
    item["picture"] = base64.b64encode(pair()["left"]).decode()
    walk(admin, "PUT", "/v1/studies/{study}/known-items/{item}", item, item=uuid.uuid4(), **STUDY)


def call_of_foods(walk, admin):
    key = {"key": QUARK["key"]}
    walk(admin, "POST", "/v1/foods", QUARK)
    walk(admin, "PATCH", "/v1/foods/{key}", {"reason": "a test", "name": "Quark"}, extra=ANY_VERSION, **key)
    density = {
        "g_per_ml": 1.05,
        "sd_g_per_ml": 0.03,
        "state": "as sold",
        "kind": "bulk",
        "method": "cup",
        "reason": "x",
    }
    walk(admin, "POST", "/v1/foods/{key}/densities", density, extra=ANY_VERSION, **key)
    walk(admin, "POST", "/v1/foods/{key}/restore", {"reason": "a test", "version": 1}, extra=ANY_VERSION, **key)
    kept = walk(admin, "POST", "/v1/studies/{study}/densities", density | {"food": QUARK["key"]}, **STUDY).json()
    withdrawal = "/v1/studies/{study}/densities/{density}/withdrawal"
    walk(admin, "POST", withdrawal, {"reason": "a mistake"}, density=kept["id"], **STUDY)
