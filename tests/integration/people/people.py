"""Staff for tests, created with a known password and signed in."""

from dataclasses import dataclass

from fastapi.testclient import TestClient

from app.people.access.caller import authenticate, require_staff
from app.people.access.passwords import Passwords
from app.people.access.secret_box import SecretBox
from app.people.access.sign_in import sign_in as open_session
from app.people.access.staff import create_staff, set_member

PASSWORD = "correct horse battery"


@dataclass(frozen=True)
class Person:
    """A signed-in staff member."""

    client: TestClient
    name: str
    headers: dict[str, str]

    def __getattr__(self, method):
        def call(path, **arguments):
            headers = self.headers | arguments.pop("headers", {})
            return getattr(self.client, method)(path, headers=headers, **arguments)

        return call


def bearer(token):
    return {"Authorization": f"Bearer {token}"}


def sign_in(client, name, password=PASSWORD):
    return client.post("/v1/sessions", json={"name": name, "password": password})


def make_staff(client, admin, name, *, is_admin=False, **roles):
    """Create a staff member with roles by study and sign them in, by the services that the calls ask."""
    state = client.app.state.api
    database, box, hashing = state.database, state.part(SecretBox), state.part(Passwords)
    caller = require_staff(authenticate(database, box, admin["Authorization"].removeprefix("Bearer ")))
    create_staff(database, hashing, name, is_admin=is_admin, password=PASSWORD, caller=caller)
    for study, role in roles.items():
        set_member(database, caller, study, name, role)
    return Person(client, name, bearer(open_session(database, box, hashing, name, PASSWORD).token))
