"""A server for the clients, one per module, and the lines over which they hold a whole conversation with it."""

from collections import Counter

import pytest
from tada_client import Staff

from tests.e2e.clients.lossy_line import lossy_line
from tests.e2e.processes import RecallingServer

LINES = {
    "clean": {"share": 0},
    "drops_a_fifth": {"share": 0.2},
    "loses_every_first_answer": {"share": 0, "loses_first_answers": True},
}
NOTED_AT_EACH_REQUEST = {"photograph.read", "participant.export", "reminders.set"}  # a repeat changes nothing
# By the conversation of either client, over any line. Received: metadata and two photographs, of the meal and after it.
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


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    server = RecallingServer(tmp_path_factory.mktemp("server"), TADA_PUSH_CONTACT="mailto:study@example.org")
    server.place_prepared_database()
    server.start()
    try:
        server.wait_until_ready()
        yield server
    finally:
        server.stop()


@pytest.fixture(scope="module")
def staff(server):
    with Staff(server.address, server.create_admin("client")) as staff:
        yield staff


@pytest.fixture(params=LINES)
def line(request, server):
    """A line of each kind. `line.study` names a study of its own."""
    with lossy_line(server.address, **LINES[request.param]) as line:
        line.study = request.param
        yield line
        assert (sum(line.dropped.values()) > 0) == (request.param != "clean")


@pytest.fixture
def changes_of(staff):
    """The audit log of a study: how often each kind of change was made."""

    def count(study):
        notes = staff.rows(f"/v1/studies/{study}/audit", {"limit": 7})
        return Counter(note["action"] for note in notes if note["action"] not in NOTED_AT_EACH_REQUEST)

    return count
