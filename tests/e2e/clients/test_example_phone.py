"""examples/phone.py holds a phone's conversation with a real server."""

import subprocess
import sys

import pytest

from tests.e2e.processes import REPOSITORY, enrolment_code

PHOTOGRAPHS = REPOSITORY / "app" / "demo_data"


@pytest.mark.slow
def test_phone_of_sixty_lines_sends_a_meal_and_says_why_a_spent_code_is_refused(server):
    code = enrolment_code(server, "P001", "example")
    command = [sys.executable, REPOSITORY / "examples" / "phone.py", server.address, code]
    command += [PHOTOGRAPHS / "left.jpg", PHOTOGRAPHS / "right.jpg"]
    first, again = (subprocess.run(command, capture_output=True, text=True, timeout=200, check=False) for _ in range(2))
    assert first.returncode == 0, first.stderr
    assert " ml " in first.stdout
    assert (again.returncode, again.stderr.startswith("enrolment_code_invalid: ")) == (1, True), again.stderr
