"""A meal and those who speak of it: a phone and a reviewer, each by the API."""

import uuid
from dataclasses import dataclass

from fastapi.testclient import TestClient


def new_event(kind, **fields):
    return {"id": str(uuid.uuid4()), "kind": kind} | fields


@dataclass(frozen=True)
class Speaker:
    """Somebody who sends events to a meal, each with the version that they have just read."""

    client: TestClient
    headers: dict[str, str]
    meal_id: str

    def meal(self):
        answer = self.client.get(f"/v1/meals/{self.meal_id}", headers=self.headers)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def items(self):
        return [item for item in self.meal()["items"] if not {"replaced", "undone"} & set(item["flags"])]

    def send(self, event, if_match=None):
        tag = if_match if if_match is not None else f'"{self.meal()["version"]}"'
        return self.client.post(
            f"/v1/meals/{self.meal_id}/events", headers=self.headers | {"If-Match": tag}, json=event
        )

    def say(self, kind, **fields):
        """The meal after an event that must be accepted."""
        answer = self.send(new_event(kind, **fields))
        assert answer.status_code == 201, answer.text
        return answer.json()

    def refused(self, kind, **fields):
        """(status, code) of an event that must be refused."""
        answer = self.send(new_event(kind, **fields))
        assert answer.status_code >= 400, answer.text
        return answer.status_code, answer.json()["code"]

    def history(self, **params):
        return self.client.get(f"/v1/meals/{self.meal_id}/events", headers=self.headers, params=params).json()
