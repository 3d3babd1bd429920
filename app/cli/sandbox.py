"""`tada sandbox`: a study for trying an app, on a throwaway server or on a given one.

It prints what an app's author needs: the address, an enrolment code that never runs out, and the
answers that the app can ask for.
"""

import os
import textwrap
import uuid
from datetime import UTC, datetime

import httpx2

from app.cli.demo import (
    MARKER,
    PLATES,
    bundled_photograph,
    checked,
    client_of,
    say,
    serve_until_interrupted,
    upload,
)
from app.core.errors import InvalidInputError
from app.extras.sandbox.answers import FIELD, HEADER
from app.messages.catalogue import photograph_codes
from app.people.schemas import EnrolmentCodeOut, EnrolmentOut

PARTICIPANT = "P001"
CONFLICT = 409
ANSWERS = (
    ("status=503 retry_after=3", "503, or 429, and when to try again; nothing is kept"),
    ("wait=20", "the answer after so many seconds"),
    (
        "lose_request=1000",
        "the connection ends after so many bytes of the request; only pieces keep what arrived",
    ),
    (
        "lose_answer=0",
        "the request is carried out, and the connection ends after so many bytes of the answer",
    ),
    ("meal=needs_review", "the meal's foods are not known"),
    ("meal=marker_not_found", "the meal fails, with any of the codes below"),
)


def run_sandbox(study: str, *, server: str | None, sends: bool, port: int) -> int:
    """Open the sandbox and return the exit status; a throwaway server is served until Ctrl-C.

    Raises InvalidInputError: there is no TADA_TOKEN for the server, or the study is no sandbox.
    """
    if server is None:
        return serve_until_interrupted(port, lambda admin: open_sandbox(admin, study, sends=sends))
    token = os.environ.get("TADA_TOKEN")
    if not token:
        raise InvalidInputError(
            "Set TADA_TOKEN to an admin's token of that server: `tada admin create NAME` prints one."
        )
    with client_of(server.rstrip("/"), token) as admin:
        open_sandbox(admin, study, sends=sends)
    return 0


def open_sandbox(admin: httpx2.Client, study: str, *, sends: bool) -> EnrolmentCodeOut:
    """Create the study unless it is there, issue an enrolment code, and print both.

    Raises InvalidInputError.
    """
    body = {
        "code": study,
        "name": "Sandbox",
        "marker": MARKER,
        "gives_feedback": True,
        "sandbox": True,
    }
    created = admin.post("/v1/studies", json=body)
    if created.status_code == CONFLICT:
        if not checked(admin.get(f"/v1/studies/{study}")).json().get("sandbox"):
            raise InvalidInputError(
                f"The study {study} is no sandbox, and cannot become one: choose another --study."
            )
    else:
        checked(created)
    participants = f"/v1/studies/{study}/participants"
    added = admin.post(participants, json={"code": PARTICIPANT})
    if added.status_code != CONFLICT:
        checked(added)
    issued = checked(admin.post(f"{participants}/{PARTICIPANT}/enrolment-codes"))
    code = EnrolmentCodeOut.model_validate_json(issued.content)
    say(f"Sandbox study {study}; what phones send is removed after a day.")
    print(f"   server          {str(admin.base_url).rstrip('/')}")
    print(
        f"   enrolment code  {code.code}   (participant {PARTICIPANT}; any number of phones, until the next code)"
    )
    print(f"   QR code's text  {code.qr_text}")
    print(f"   a browser       {code.capture_url}")
    say(
        f"Answers to ask for, by the header {HEADER} or by the field {FIELD!r} of a meal's metadata (docs/sandbox.md):"
    )
    for text, meaning in ANSWERS:
        print(f"   {text:<25} {meaning}")
    codes = textwrap.wrap(", ".join(sorted(photograph_codes())), 100)
    print("\n".join(f"      {line}" for line in codes))
    if sends:
        send_meals(admin, code.code)
    return code


def send_meals(admin: httpx2.Client, code: str) -> None:
    """Enrol a phone and send the bundled meals."""
    device = {"code": code, "device_name": "tada sandbox", "model": "Sample phone"}
    enrolled = checked(admin.post("/v1/enrolments", json=device))
    with client_of(
        admin.base_url, EnrolmentOut.model_validate_json(enrolled.content).token
    ) as phone:
        for plate in PLATES.values():
            metadata = {
                "id": str(uuid.uuid4()),
                "captured_at": datetime.now(UTC).isoformat(timespec="seconds"),
                "time_zone": "Etc/UTC",
                "hints": [{"point": point} for point in plate.points.values()],
            }
            meal = upload(
                phone,
                metadata,
                {side: bundled_photograph(plate.folder, side) for side in ("left", "right")},
            )
            print(f"   sent {plate.folder or 'apple':<22} meal {meal.id}", flush=True)
