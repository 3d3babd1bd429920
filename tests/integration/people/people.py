"""Staff for tests, created with a known password and signed in over HTTP."""

from dataclasses import dataclass

from fastapi.testclient import TestClient

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
    """Create a staff member with roles by study and sign them in."""
    body = {"name": name, "is_admin": is_admin, "password": PASSWORD}
    answer = client.post("/v1/staff", headers=admin, json=body)
    assert answer.status_code == 201, answer.text
    for study, role in roles.items():
        answer = client.put(f"/v1/studies/{study}/members/{name}", headers=admin, json={"role": role})
        assert answer.status_code == 200, answer.text
    return Person(client, name, bearer(sign_in(client, name).json()["token"]))
