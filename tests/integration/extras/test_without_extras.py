"""The server without its side features: what it answers, and that nothing in it needs them."""

import subprocess
import sys

import pytest

from app.core.settings import Settings
from app.main import create_app
from tests.integration.conftest import STUDY_MARKER, meal_metadata
from tests.integration.dashboard.conftest import Browser
from tests.integration.people.people import make_staff
from tests.support.photographs import pair

IMPORT_THE_CORE = """
import importlib, pathlib, sys
import app
folder = pathlib.Path(app.__file__).parent
ABOVE = ("app.extras", "app.main", "app.worker", "app.cli")
for path in folder.rglob("*.py"):
    name = ".".join(path.relative_to(folder.parent).with_suffix("").parts)
    if not name.startswith(ABOVE):
        importlib.import_module(name.removesuffix(".__init__"))
print([name for name in sys.modules if name.startswith(ABOVE)])
"""


@pytest.fixture(scope="module")
def app():
    return create_app(Settings(), extras=())


def test_server_without_extras_answers_all_else(client, admin, enrol):
    study = {"code": "pilot", "name": "Pilot", "marker": STUDY_MARKER, "sandbox": True}
    client.post("/v1/studies", headers=admin, json=study)
    phone = enrol()
    sent = phone.post(pair(), meal_metadata(sandbox="status=503"))
    assert (sent.status_code, sent.json()["ignored"]) == (202, ["sandbox"])
    for path in ("/v1/meals", "/v1/records", "/v1/days", "/v1/me"):
        assert client.get(path, headers=phone.headers).status_code == 200, path
    for path in ("/v1/studies/pilot/exports", "/v1/studies/pilot/releases", "/v1/records?format=csv"):
        assert client.get(path, headers=admin).status_code == 200, path
    make_staff(client, admin, "olga", pilot="owner")
    assert "P001" in Browser(client, "olga").page("/dashboard/studies/pilot/participants")
    assert "reminders" not in client.get("/v1/server").json()["features"]
    for path in ("/fhir/metadata", "/fhir/NutritionIntake", "/v1/me/reminders"):
        assert client.get(path, headers=phone.headers).status_code == 404, path
        assert path not in client.app.openapi()["paths"]


def test_core_imports_no_extra():
    command = [sys.executable, "-c", IMPORT_THE_CORE]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
