"""clients/typescript: its types agree with the server's document, and it holds a phone's whole conversation."""

import hashlib
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
from tests.e2e.clients.lossy_line import lossy_line
from tests.e2e.processes import REPOSITORY, enrolled_client, enrolment_code

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


def test_large_photograph_continues_where_the_line_broke(server):
    script = REPOSITORY / "tests" / "e2e" / "clients" / "typescript_large_photograph.mjs"
    size = 5 * 1024**2 + (PHOTOGRAPHS / "left.jpg").stat().st_size
    with enrolled_client(server, "P005", "large") as phone, lossy_line(server.address, share=0) as line:
        line.broken_bodies += [700_000, 1_400_000, 300_000]
        token = phone.headers["Authorization"].removeprefix("Bearer ")
        sent = json.loads(run("node", str(script), line.address, token, str(PHOTOGRAPHS)))
        assert line.broken_bodies == []
        assert line.photograph_bytes < size + 500_000  # from the start it would have been 2,400,000 more
        image = phone.get(f"/v1/meals/{sent['id']}").json()["images"]["left"]
        assert (image["durable"], image["received_sha256"]) == (True, sent["sha256"])


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


def test_no_meal_is_lost_or_doubled_over_a_line_that_drops_requests(server):
    with enrolled_client(server, "P003", "lossy-typescript") as phone, lossy_line(server.address, seed=1) as line:
        token = phone.headers["Authorization"].removeprefix("Bearer ")
        script = REPOSITORY / "tests" / "e2e" / "clients" / "typescript_meals.mjs"
        sent = json.loads(run("node", str(script), line.address, token, str(PHOTOGRAPHS), "10"))
        assert 0.1 < sum(line.dropped.values()) / line.requests < 0.3
        assert all(line.dropped.values()), line.dropped
        kept = phone.get("/v1/meals", params={"limit": 1000}).json()["items"]
        assert sorted(meal["id"] for meal in kept) == sorted(sent)
        for number, meal_id in enumerate(sent):
            images = phone.get(f"/v1/meals/{meal_id}").json()["images"]
            assert {slot: image["received_sha256"] for slot, image in images.items()} == {
                side: hashlib.sha256((PHOTOGRAPHS / f"{side}.jpg").read_bytes() + bytes([number])).hexdigest()
                for side in ("left", "right")
            }
