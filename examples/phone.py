"""A phone in sixty lines: enrol, send a meal part by part, wait for the estimate, confirm it.

    python examples/phone.py http://127.0.0.1:8000 ENROLMENT_CODE left.jpg right.jpg

It makes the meal's id itself, so that each call may be repeated; docs/apps.md says what a real app does beside this.
"""

import sys
import time
import uuid
from datetime import UTC, datetime
from pathlib import Path

import httpx2

DONE = {"estimated", "needs_review", "failed", "confirmed"}
TRIES = 5


def call(phone: httpx2.Client, method: str, path: str, **options) -> dict:
    """Call the API; after no answer, or one that may be repeated, call again."""
    for attempt in range(TRIES):
        try:
            answer = phone.request(method, path, **options)
        except httpx2.TransportError:
            time.sleep(2**attempt)
            continue
        body = answer.json()
        if answer.is_success:
            return body
        if not body["retryable"]:
            raise SystemExit(f"{body['code']}: {body['detail']}")
        time.sleep(float(answer.headers.get("Retry-After", 2**attempt)))
    raise SystemExit("no answer: keep the meal, and try again later")


def main(server: str, code: str, left: str, right: str) -> None:
    with httpx2.Client(base_url=server, timeout=75) as phone:
        enrolment = {"code": code, "secret": uuid.uuid4().hex, "device_name": "example"}
        phone.headers["Authorization"] = (
            f"Bearer {call(phone, 'POST', '/v1/enrolments', json=enrolment)['token']}"
        )
        meal = f"/v1/meals/{uuid.uuid4()}"
        metadata = {"captured_at": datetime.now(UTC).isoformat(), "time_zone": "Europe/London"}
        call(phone, "PUT", meal, json=metadata)
        for slot, path in (("left", left), ("right", right)):
            call(phone, "PUT", f"{meal}/images/{slot}", content=Path(path).read_bytes())
            # with images[slot]["durable"] in the answer a phone may delete its copy
        while (estimate := call(phone, "GET", meal, params={"wait": 25}))["status"] not in DONE:
            print(estimate["status"], estimate["stage"])
        for item in estimate["items"]:
            name = item["food"]["name"] if item["food"] else "unknown food"
            print(name, item["volume_ml"], "ml", item["mass_g"], "g")
        if estimate["items"] and all(item["food"] and item["mass_g"] for item in estimate["items"]):
            version = {"If-Match": f'"{estimate["version"]}"'}
            event = {"id": str(uuid.uuid4()), "kind": "confirm_meal"}
            print(call(phone, "POST", f"{meal}/events", json=event, headers=version)["status"])


if __name__ == "__main__":
    main(*sys.argv[1:])
