"""clients/typescript: its types agree with the server's document, and it holds a phone's whole conversation."""

import json
import os
import re
import shutil
import subprocess
from collections import Counter

import pytest

from app.core.settings import Settings
from app.main import create_app
from tests.e2e.clients.conftest import CHANGES
from tests.e2e.processes import REPOSITORY, enrolment_code

FOLDER = REPOSITORY / "clients" / "typescript"
PHOTOGRAPHS = REPOSITORY / "app" / "demo_data"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("npm") is None, reason="node and npm are not installed"),
]


def run(*command, folder=FOLDER, **variables):
    done = subprocess.run(
        command, cwd=folder, env=os.environ | variables, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_unit_tests_pass():
    assert "# fail 0" in run("node", "--test", "--test-reporter=tap", "test/")


def test_package_builds_with_types_of_this_servers_document(tmp_path):
    shutil.copytree(FOLDER, tmp_path / "client", ignore=shutil.ignore_patterns("node_modules", "types", "schema.d.ts"))
    document = tmp_path / "openapi.json"
    document.write_text(json.dumps(create_app(Settings(data_dir=tmp_path)).openapi()))
    client = tmp_path / "client"
    run("npm", "install", "--silent", "--no-package-lock", "--no-audit", "--ignore-scripts", folder=client)
    run("npm", "run", "build", folder=client, TADA_OPENAPI=str(document))
    assert "dependencies" not in json.loads((client / "package.json").read_text())
    (client / "use.ts").write_text(
        'import { TadaClient, Problem, newId, type Schemas } from "tada-client";\n'
        'const phone = new TadaClient({ server: "https://tada.example.org", token: "t" });\n'
        'const metadata: Schemas["MealMetadataIn"] = { captured_at: "", time_zone: "" };\n'
        "export const meal = await phone.sendMeal(newId(), metadata, { left: new Blob() });\n"
        'await phone.sendEvent(meal, { kind: "set_food", item: "", food: "apple" });\n'
        "// @ts-expect-error: an event without its food\n"
        'await phone.sendEvent(meal, { kind: "set_food", item: "" });\n'
        "// @ts-expect-error: no such slot\n"
        'await phone.putPhotograph("", "middle", new Blob());\n'
        "export const code: string = new Problem(404, null, null).code;\n"
    )
    options = ["--strict", "--noEmit", "--module", "nodenext", "--target", "es2022"]
    run("node_modules/.bin/tsc", *options, "use.ts", folder=client)


def test_whole_conversation_with_a_real_server(server, line, changes_of):
    code = enrolment_code(server, study=line.study, gives_feedback=True)
    script = REPOSITORY / "tests" / "e2e" / "clients" / "typescript_conversation.mjs"
    assert run("node", str(script), line.address, code, str(PHOTOGRAPHS)).endswith("done\n")
    assert changes_of(line.study) == CHANGES + Counter({"meal.declare": 1, "meal.event": 1})


def test_example_of_the_readme_confirms_a_meal(server, tmp_path):
    (example,) = re.findall(r"^```js\n(.*?)^```$", (FOLDER / "README.md").read_text(), re.DOTALL | re.MULTILINE)
    (tmp_path / "node_modules").mkdir()
    (tmp_path / "node_modules" / "tada-client").symlink_to(FOLDER)
    (tmp_path / "example.mjs").write_text(
        'import { openAsBlob } from "node:fs";\n'
        'import { TadaClient, newId } from "tada-client";\n'
        "const [server, code, folder] = process.argv.slice(2);\n"
        "const left = await openAsBlob(`${folder}/left.jpg`), right = await openAsBlob(`${folder}/right.jpg`);\n"
        f"{example}\nconsole.log(confirmed.status);\n"
    )
    code = enrolment_code(server, participant="P002")
    printed = run("node", "example.mjs", server.address, code, str(PHOTOGRAPHS), folder=tmp_path)
    assert printed.endswith("confirmed\n"), printed
