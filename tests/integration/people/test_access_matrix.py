"""Every route as every role, in the own study and in another: the answer is what the table of rules says.

The expected answer is worked out here from a rule, apart from the code that enforces it. Paths are filled in by what
they ask for, so that a new route needs no change here: only its rule.
"""

import itertools
import re
import uuid
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime, timedelta

import pytest
from fastapi.routing import APIRoute

from app.core.settings import Settings
from app.main import create_app
from app.meals.stored.models import Meal
from app.people.access.access_rules import SAFE_METHODS
from app.people.access.caller import new_token, sha256_hex
from app.people.access.secret_box import SecretBox
from app.people.models import AccessToken, Device, Participant, Staff, Study, StudyMember
from app.people.privacy_models import Tombstone
from tests.integration.people.people import bearer
from tools.access_table import PAGE, page_with_lists

# what the server can do is no secret, nor are scripts and styles of the pages
OUT_OF_THE_API = {"/openapi.json", "/docs", "/docs/guide", "/dashboard/static", "/capture"}
RANKS = {"any": 0, "viewer": 1, "reviewer": 2, "owner": 3, "admin": 4}
NO_STUDY = "There is no such study."
numbers = itertools.count()


@dataclass(frozen=True)
class Role:
    """Who calls, seen from the study in the path. rank: what they are there; None: no staff, or nothing there."""

    name: str
    kind: str  # nobody, withdrawn, phone, session or token
    rank: int | None = None
    is_own: bool = True
    is_admin: bool = False
    scope: str = "write"


ROLES = [
    Role("nobody", "nobody"),
    Role("phone that was withdrawn", "withdrawn"),
    Role("phone of the study", "phone"),
    Role("phone of another study", "phone", is_own=False),
    Role("viewer", "session", 1),
    Role("reviewer", "session", 2),
    Role("owner", "session", 3),
    Role("owner of another study", "session", None, is_own=False),
    Role("staff of no study", "session", None, is_own=False),
    Role("admin", "session", 4, is_admin=True),
    Role("owner's token", "token", 3),
    Role("owner's read-only token", "token", 3, scope="read"),
    Role("owner's token for another study", "token", None, is_own=False),
]


@dataclass(frozen=True)
class Expected:
    """status None: let in; is_sure False: it may also hear that there is no such thing, or that the body is wrong."""

    status: int | None = None
    codes: frozenset[str] = field(default_factory=frozenset)
    is_sure: bool = True


IN = Expected()
NO_SUCH = Expected(404, frozenset({"not_found"}))


def refused(status, *codes):
    return Expected(status, frozenset(codes))


def expected(role, rule, method, path):
    """What the rule promises to the role."""
    if rule.is_open:
        return IN
    if rule.scraper:  # none of these calls from the same machine, and no token is set
        return NO_SUCH
    if role.kind == "nobody":
        return refused(401, "unauthenticated")
    if role.kind == "withdrawn":
        return refused(410, "withdrawn")
    reads = method in SAFE_METHODS
    is_about_the_study = "{study}" in path or ("{meal_id}" in path and (reads or method == "DELETE"))
    if role.kind == "phone":
        return expected_by_phone(role, rule, is_about_the_study)
    return refused_by_rule(role, rule, reads) or expected_in_study(role, RANKS[rule.staff], is_about_the_study)


def expected_by_phone(role, rule, is_about_the_study):
    if not rule.device:
        return refused(403, "staff_only", "admin_only")
    return NO_SUCH if is_about_the_study and not role.is_own else IN


def refused_by_rule(role, rule, reads):
    """What staff hear whatever their role in the study is; None: nothing."""
    if rule.staff is None:
        return refused(403, "device_only")
    if rule.staff == "admin" and not role.is_admin:
        return refused(403, "admin_only")
    if rule.session and role.kind == "token":
        return refused(403, "session_needed")
    if not reads and role.scope == "read":
        return refused(403, "token_read_only")
    return None


def expected_in_study(role, needs, is_about_the_study):
    if role.is_admin or needs == RANKS["any"] or (role.rank or 0) >= needs:
        return IN
    promised = NO_SUCH if role.rank is None else refused(403, "role_too_low")
    return promised if is_about_the_study else replace(promised, is_sure=False)


@dataclass(frozen=True)
class World:
    """Two studies, a participant, phone and meal in each, and everybody who may call."""

    study: str
    participant: str
    meal_id: uuid.UUID
    headers: dict[str, dict[str, str]]


def make_world(state):
    number, now = next(numbers), datetime.now(UTC)
    tokens = {role.name: new_token() for role in ROLES if role.kind != "nobody"}
    own, other = (
        Study(id=uuid.uuid4(), code=f"{name}-{number}", name=name, marker="plain:9x7:11", created_at=now)
        for name in ("own", "other")
    )
    rows, people = [own, other], {}
    for study in (own, other):
        person = Participant(id=uuid.uuid4(), study_id=study.id, code="P1", created_at=now)
        device = Device(id=uuid.uuid4(), participant_id=person.id, name="phone", enrolled_at=now)
        people[study.id] = (person, device)
        rows += [person, device]
    person, device = people[own.id]
    meal = Meal(
        id=uuid.uuid4(),
        client_id=uuid.uuid4(),
        study_id=own.id,
        participant_id=person.id,
        device_id=device.id,
        captured_at=now - timedelta(hours=1),
        utc_offset_minutes=0,
        time_zone="UTC",
        local_date=date(2026, 11, 20),
        details={"captured_at": "", "time_zone": "UTC", "marker": None, "camera": None, "hints": [], "location": None},
        status="receiving",
        received_at=now,
    )
    rows.append(meal)

    def token(role, **owner):
        kind = {"phone": "device", "session": "session", "token": "personal"}[role.kind]
        return AccessToken(
            id=uuid.uuid4(),
            token_sha256=sha256_hex(tokens[role.name]),
            kind=kind,
            scope=role.scope,
            created_at=now,
            expires_at=now + timedelta(hours=1),
            **owner,
        )

    for role in ROLES:
        if role.kind == "phone":
            rows.append(token(role, device_id=people[(own if role.is_own else other).id][1].id))
        elif role.kind == "withdrawn":
            digest = state.part(SecretBox).digest("token", sha256_hex(tokens[role.name]))
            rows.append(Tombstone(kind="token", digest=digest, study_id=own.id, erased_at=now))
        elif role.kind in ("session", "token"):
            staff = Staff(id=uuid.uuid4(), name=f"{role.name} {number}", is_admin=role.is_admin, created_at=now)
            rows.append(staff)
            reached = {
                "owner of another study": {other: "owner"},
                "owner's token for another study": {own: "owner", other: "owner"},
            }.get(role.name, {own: {1: "viewer", 2: "reviewer", 3: "owner"}.get(role.rank)})
            rows += [
                StudyMember(study_id=study.id, staff_id=staff.id, role=held, created_at=now)
                for study, held in reached.items()
                if held is not None
            ]
            only = other.id if role.name == "owner's token for another study" else None
            rows.append(token(role, staff_id=staff.id, study_id=only))
    with state.database.write() as session:
        for model in (Study, Participant, Device, Staff):  # those that others name come first
            session.add_all([row for row in rows if isinstance(row, model)])
            session.flush()
        session.add_all(rows)
    headers = {role.name: bearer(tokens[role.name]) if role.name in tokens else {} for role in ROLES}
    return World(own.code, person.code, meal.client_id, headers)


def leaves(routes):
    """The routes, those of included routers too."""
    for route in routes:
        included = getattr(route, "original_router", None)
        if included is None:
            yield route
        else:
            yield from leaves(included.routes)


def routes_of(app):
    found = {
        (method, route.path) for route in leaves(app.routes) if isinstance(route, APIRoute) for method in route.methods
    }
    assert len(found) > 50  # whatever FastAPI makes of its routes, they must be found
    return found


def fill(path, operation, world):
    """The path with something in each place: ours where we know it, else what its schema asks for."""
    known = {"study": world.study, "participant": world.participant, "meal_id": world.meal_id}
    for parameter in operation.get("parameters", ()):
        if parameter["in"] == "path":
            path = path.replace(f"{{{parameter['name']}}}", str(known.get(parameter["name"], something(parameter))))
    for name, value in known.items():  # pages are in no document
        path = path.replace(f"{{{name}}}", str(value))
    return re.sub(r"\{slot[^}]*\}", "left", re.sub(r"\{day\}", "2026-11-20", path))


def as_browser(headers):
    """The same caller, the token in the cookie, on a page of ours."""
    token = headers.get("Authorization", "").removeprefix("Bearer ")
    return {"Sec-Fetch-Site": "same-origin"} | ({"Cookie": f"tada_session={token}"} if token else {})


def something(parameter):
    schema = parameter["schema"]
    if "enum" in schema:
        return schema["enum"][0]
    if "const" in schema:
        return schema["const"]
    by_format = {"uuid": uuid.uuid4(), "date": "2026-11-20", "date-time": "2026-11-20T12:00:00Z"}
    by_type = {"integer": max(1, schema.get("minimum", 1)), "number": 1, "boolean": "true"}
    return by_format.get(schema.get("format")) or by_type.get(schema.get("type"), "x")


def outcome_of(answer):
    """FHIR's way to tell the same: the problem's code and words in an OperationOutcome."""
    if answer.headers.get("content-type") != "application/fhir+json" or answer.status_code < 400:
        return {}
    details = answer.json()["issue"][0]["details"]
    return {"code": details["coding"][0]["code"], "detail": details["text"]}


def fault_of(role, route, answer, promised):
    """Why the answer is not what was promised, or None."""
    body = answer.json() if answer.headers.get("content-type") == "application/problem+json" else outcome_of(answer)
    said = f"{role.name}, {route[0]} {route[1]}: {answer.status_code} {body.get('code')} ({body.get('detail')})"
    refusals = {"unauthenticated", "withdrawn", "staff_only", "device_only", "admin_only", "role_too_low", "no_rule"}
    refusals |= {"token_read_only", "session_needed"}
    is_refused = body.get("code") in refusals or body.get("detail") == NO_STUDY
    if answer.status_code >= 500:
        return f"{said}: a server error"
    if promised.status is None:
        return f"{said}: should be let in" if is_refused else None
    if answer.status_code == promised.status and body.get("code") in promised.codes:
        return None
    if promised.is_sure:
        return f"{said}: should be {promised.status} {sorted(promised.codes)}"
    gave_something = 200 <= answer.status_code < 300 and route[0] not in SAFE_METHODS
    return f"{said}: should not be let in" if gave_something else None


@pytest.mark.parametrize("role", ROLES, ids=lambda role: role.name.replace(" ", "-"))
def test_each_route_enforces_its_rule(client, state, role):
    paths = client.app.openapi()["paths"]
    faults, world = [], make_world(state)
    for method, path in sorted(routes_of(client.app)):
        rule = client.app.state.rules[method, path]
        promised = expected(role, rule, method, path)
        operation = paths.get(path, {}).get(method.lower(), {})
        headers = world.headers[role.name]
        if rule.page:
            headers = as_browser(headers)
        answer = client.request(method, fill(path, operation, world), headers=headers, follow_redirects=False)
        fault = fault_of(role, (method, path), answer, promised)
        faults += [fault] if fault else []
        if answer.status_code < 400 and method not in SAFE_METHODS:
            world = make_world(state)  # it may have ended what the next call needs
    assert not faults, "\n".join(faults)


@pytest.fixture(scope="module")
def app():
    return create_app(Settings())


def test_every_route_has_a_rule_and_every_rule_a_route(app):
    assert routes_of(app) == set(app.state.rules)
    assert {route.path for route in leaves(app.routes) if not isinstance(route, APIRoute)} <= OUT_OF_THE_API


def test_every_rule_is_in_the_document_that_apps_are_written_by(app):
    told = {(method.upper(), path) for path, methods in app.openapi()["paths"].items() for method in methods}
    # what monitoring reads is no business of apps
    shown = {route for route, rule in app.state.rules.items() if not rule.scraper and not rule.page}
    assert {route for route in shown if route[0] != "HEAD"} == told


def test_route_without_a_rule_is_refused_to_everybody(client, state):
    @client.app.get("/v1/forgotten")
    def forgotten():
        return "secret"

    world = make_world(state)
    for role in ROLES:
        answer = client.get("/v1/forgotten", headers=world.headers[role.name])
        assert (answer.status_code, answer.json()["code"]) == (403, "no_rule"), role.name


def test_page_of_the_rules_is_up_to_date():
    page = PAGE.read_text()
    assert page == page_with_lists(page), "write it anew: python -m tools.access_table"
