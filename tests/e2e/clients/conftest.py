"""A server for all clients of a worker, and the line over which they hold a whole conversation with it."""

import uuid
from collections import Counter

import pytest
from tada_client import Staff

from tests.e2e.clients.lossy_line import lossy_line
from tests.e2e.processes import RecallingServer

NOTED_AT_EACH_REQUEST = {"photograph.read", "participant.export", "reminders.set"}  # a repeat changes nothing
# By the conversation of either client. Received: metadata and two photographs, of the meal and after it.
CHANGES = Counter(
    {
        "study.create": 1,
        "participant.create": 1,
        "enrolment_code.issue": 1,
        "device.enrol": 1,
        "meal.receive": 6,
        "meal.event": 1,
        "day.closed": 1,
        "reminders.delete": 1,
        "meal.erase": 1,
        "participant.withdraw": 1,
    }
)


@pytest.fixture(scope="package")
def server(tmp_path_factory):
    server = RecallingServer(tmp_path_factory.mktemp("server"), TADA_PUSH_CONTACT="mailto:study@example.org")
    server.place_prepared_database()
    server.start()
    try:
        server.wait_until_ready()
        yield server
    finally:
        server.stop()


@pytest.fixture(scope="package")
def staff(server):
    with Staff(server.address, server.create_admin("client")) as staff:
        yield staff


@pytest.fixture
def line(server):
    """A line that loses each first answer and drops a fifth of all else. `line.study` names a study of its own."""
    with lossy_line(server.address, loses_first_answers=True) as line:
        line.study = f"study-{uuid.uuid4().hex[:8]}"
        yield line
        assert sum(line.dropped.values()) > line.dropped["after"] > 0


@pytest.fixture
def changes_of(staff):
    """The audit log of a study: how often each kind of change was made."""

    def count(study):
        notes = staff.rows(f"/v1/studies/{study}/audit", {"limit": 7})
        return Counter(note["action"] for note in notes if note["action"] not in NOTED_AT_EACH_REQUEST)

    return count
