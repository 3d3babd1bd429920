"""A phone that tries a server: its calls, and the faults of its line."""

import hashlib
import http.client
import json
import time
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import httpx2

METADATA: Mapping[str, Any] = {
    "captured_at": "2026-11-20T12:30:00+08:00",
    "time_zone": "Asia/Shanghai",
}
JSON_TYPE = "application/json"
MOST_TRIES = 5
LONGEST_PAUSE_SECONDS = 60
CALL_SECONDS = 90.0  # longer than a wait


@dataclass(slots=True)
class TrialPhone:
    """An enrolled phone. pair: photographs by slot. meal: the id of the meal that most checks are about."""

    client: httpx2.Client
    token: str
    pair: Mapping[str, bytes]
    meal: str = field(default_factory=lambda: str(uuid.uuid4()))

    def call(self, method: str, path: str, **arguments: Any) -> httpx2.Response:
        """Send one request with the token; again after `Retry-After`, where the server is busy."""
        headers = {"Authorization": f"Bearer {self.token}"} | arguments.pop("headers", {})
        for _ in range(MOST_TRIES):
            answer = self.client.request(method, path, headers=headers, **arguments)
            after = answer.headers.get("retry-after", "")
            if answer.status_code not in {429, 503} or not after.isdecimal():
                break
            time.sleep(min(int(after), LONGEST_PAUSE_SECONDS))
        return answer

    def put_meal(self, meal: str, **changes: object) -> httpx2.Response:
        """Announce a meal."""
        return self.call("PUT", f"/v1/meals/{meal}", json={**METADATA, **changes})

    def put_photograph(self, slot: str, content: bytes | None = None) -> httpx2.Response:
        """Send a photograph of the meal. content: default: the pair's."""
        body = content if content is not None else self.pair[slot]
        headers = {"Content-Type": "application/octet-stream"}
        return self.call(
            "PUT", f"/v1/meals/{self.meal}/images/{slot}", content=body, headers=headers
        )

    def read(self) -> dict[str, Any]:
        """Return the meal as it is."""
        return document(self.call("GET", f"/v1/meals/{self.meal}"))

    def send_event(self, event: Mapping[str, str], if_match: str | None) -> httpx2.Response:
        """Send an event of the meal."""
        headers = {"If-Match": if_match} if if_match is not None else {}
        return self.call("POST", f"/v1/meals/{self.meal}/events", json=event, headers=headers)

    def lose_answer(self, method: str, path: str, body: bytes, content_type: str) -> None:
        """Send a request whole, and end the connection before its answer."""
        self._send_raw(method, path, body, content_type, len(body))

    def lose_request(self, method: str, path: str, body: bytes, content_type: str) -> None:
        """Send half a request's body, and end the connection."""
        self._send_raw(method, path, body, content_type, len(body) // 2)

    def _send_raw(self, method: str, path: str, body: bytes, content_type: str, most: int) -> None:
        address = urlsplit(str(self.client.base_url))
        kind = (
            http.client.HTTPSConnection if address.scheme == "https" else http.client.HTTPConnection
        )
        connection = kind(address.hostname or "", address.port, timeout=CALL_SECONDS)
        try:
            connection.putrequest(method, address.path.rstrip("/") + path)
            connection.putheader("Authorization", f"Bearer {self.token}")
            connection.putheader("Content-Type", content_type)
            connection.putheader("Content-Length", str(len(body)))
            connection.endheaders()
            connection.send(body[:most])
        finally:
            connection.close()


def enrol(
    client: httpx2.Client, code: str, pair: Mapping[str, bytes]
) -> tuple[httpx2.Response, TrialPhone | None]:
    """Enrol a phone. Returns the answer, and the phone if there is one."""
    device = {"code": code, "device_name": "conformance kit", "app_version": "conformance"}
    answer = client.post("/v1/enrolments", json=device)
    token = document(answer).get("token")
    return answer, TrialPhone(client, token, pair) if isinstance(token, str) else None


def document(answer: httpx2.Response) -> dict[str, Any]:
    """Return the JSON object of an answer, or an empty one."""
    try:
        content = answer.json()
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {}


def metadata_body(**fields: object) -> bytes:
    """Return a meal's metadata as they are sent."""
    return json.dumps({**METADATA, **fields}).encode()


def digest(content: bytes) -> str:
    """Return a photograph's SHA-256."""
    return hashlib.sha256(content).hexdigest()
