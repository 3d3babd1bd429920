"""Clients that others' generators make of our OpenAPI document: whole, and good for a phone's conversation.

The generators are installed into folders of the tests' own: the one for Python takes no typer as new as ours.
"""

import json
import os
import shutil
import subprocess
import sys

import pytest

from app.core.settings import Settings
from app.main import create_app
from tests.e2e.processes import REPOSITORY, enrolment_code

FOR_PYTHON = "openapi-python-client==0.29.1"
FOR_TYPESCRIPT = ("openapi-typescript@7.13.0", "openapi-fetch@0.17.0", "typescript@5.9.3", "@types/node@24.10.1")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    folder = tmp_path_factory.mktemp("document")
    path = folder / "openapi.json"
    path.write_text(json.dumps(create_app(Settings(data_dir=folder)).openapi()))
    return path


def run(folder, *command):
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_python_client_is_whole_and_carries_a_phones_conversation(document, server, tmp_path):
    run(tmp_path, sys.executable, "-m", "venv", "tools")
    python = tmp_path / "tools" / "bin" / "python"
    run(tmp_path, python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", FOR_PYTHON)
    config = REPOSITORY / "clients" / "openapi-python-client.yaml"
    generate = [python, "-m", "openapi_python_client", "generate", "--meta", "none", "--config", config]
    printed = run(tmp_path, *generate, "--path", document, "--output-path", "phone_client")
    assert "WARNING" not in printed, printed  # an operation or a schema was skipped
    assert "Unable" not in printed, printed
    script = REPOSITORY / "tests" / "e2e" / "clients" / "generated_client.py"
    about = [tmp_path, server.address, server.create_admin("me of a generated client"), document]
    run(tmp_path, python, "-W", "error", script, *about, REPOSITORY / "app" / "demo_data")


def test_typescript_types_carry_a_phones_conversation(document, server, tmp_path):
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed")
    run(tmp_path, "npm", "install", "--silent", "--no-save", "--no-package-lock", "--no-audit", *FOR_TYPESCRIPT)
    tools = tmp_path / "node_modules" / ".bin"
    (tmp_path / "package.json").write_text('{"type": "module"}')
    generate = (tools / "openapi-typescript", document, "--default-non-nullable", "false")  # as docs/apps.md says
    run(tmp_path, *generate, "--output", "schema.d.ts")
    shutil.copy(REPOSITORY / "tests" / "e2e" / "clients" / "generated_conversation.ts", tmp_path)
    strict = ("--strict", "--noUncheckedIndexedAccess", "--module", "nodenext", "--target", "es2022", "--types", "node")
    run(tmp_path, tools / "tsc", *strict, "generated_conversation.ts")
    photographs = REPOSITORY / "app" / "demo_data"
    code = enrolment_code(server, study="generated")
    assert run(tmp_path, "node", "generated_conversation.js", server.address, code, photographs).endswith("done\n")
