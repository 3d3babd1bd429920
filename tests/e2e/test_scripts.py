"""Every block of docs/scripts.md, run as printed against a real server; what it loads is what the API's pages tell."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
import uuid
from dataclasses import dataclass

import pytest

from app.core.settings import Settings
from app.exports.releases.file_runner import FileRunner
from app.people.access.secret_box import open_secret_box
from app.storage.opening import open_blob_store
from tests.e2e.dashboard_server import PASSWORD, dashboard_server, require
from tests.e2e.processes import REPOSITORY
from tests.support.estimates import found_item, unmeasured_item

pytestmark = pytest.mark.slow

PAGE = (REPOSITORY / "docs" / "scripts.md").read_text()
HEADING_OR_BLOCK = re.compile(r"^#+ ([^\n]+)$|^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
COMMANDS = {"bash": ["bash", "-euo", "pipefail", "-c"], "python": [sys.executable, "-c"], "r": ["Rscript", "-e"]}
APPLE = [{"point": [30, 20], "food": "apple"}]


@dataclass
class World:
    """A server with data, and somebody's folder and token."""

    served: object
    phones: dict
    folder: object
    token: str

    def records(self):
        """All records by the API's pages."""
        rows, path = [], "/v1/records?study=pilot&limit=2"
        while path:
            page = require(self.served.admin.get(path))
            rows += page["items"]
            path = page["next"]
        return rows

    def expected(self):
        rows = self.records()
        return len(rows), pytest.approx(sum(row["energy_kcal"] or 0 for row in rows))

    def run(self, heading):
        """A block's output."""
        language, script = BLOCK[heading]
        command = COMMANDS[language]
        if shutil.which(command[0]) is None:
            pytest.skip(f"{command[0]} is not installed: the block {heading!r} of docs/scripts.md is not run")
        variables = {"TADA_SERVER": self.served.address, "TADA_TOKEN": self.token, "PATH": os.environ["PATH"]}
        done = subprocess.run(
            [*command, script], env=variables, cwd=self.folder, capture_output=True, text=True, timeout=240, check=False
        )
        assert done.returncode == 0, f"{heading}: {done.stderr}\n{done.stdout}"
        return done.stdout

    def loaded(self, heading):
        """(rows, energy) that a block prints in its last line, and what stands behind them."""
        rows, energy, *more = self.run(heading).strip().splitlines()[-1].split()
        return (int(rows), float(energy)), more


def blocks():
    """(heading, language, script) of each block."""
    heading, found = "", []
    for title, language, script in HEADING_OR_BLOCK.findall(PAGE):
        heading = title or heading
        if language:
            found.append((heading, language, script))
    return found


BLOCKS = blocks()
BLOCK = {heading: (language, script) for heading, language, script in BLOCKS}


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    served = dashboard_server(tmp_path_factory.mktemp("scripts"))
    try:
        served.make_study()
        served.make_staff("ann", pilot="viewer")
        phones = {code: served.enrol(code) for code in ("P001", "007")}
        served.send_meal(phones["P001"], found_item(), unmeasured_item(hint=None), hints=APPLE)
        served.send_meal(phones["007"], found_item(90.0), hints=APPLE, captured_at="2026-11-19T12:30:00+08:00")
        served.send_meal(phones["007"], found_item(61.5), hints=APPLE, captured_at="2026-11-18T12:30:00+08:00")
        session = require(served.admin.post("/v1/sessions", json={"name": "ann", "password": PASSWORD}))
        headers = {"Authorization": f"Bearer {session['token']}"}
        body = {"name": "scripts", "scope": "read", "study": "pilot"}
        token = require(served.admin.post("/v1/tokens", json=body, headers=headers))["token"]
        yield World(served, phones, tmp_path_factory.mktemp("folder"), token)
        for phone in phones.values():
            phone.close()
    finally:
        served.close()


def make_files(served):
    """As a worker would."""
    settings = Settings(data_dir=served.server.data_dir, database_url=None, blob_url=None, erasure_url=None)
    blobs = open_blob_store(settings.resolved_blob_url, settings)
    runner = FileRunner(served.database, blobs, settings, open_secret_box(settings), uuid.uuid4())
    assert runner.run_one().outcome == "done"


def test_every_block_is_run_here():
    run = {"Scripts", "curl", "Python, pandas", "Python, polars", "R", "Items beside the data dictionary"}
    run |= {"A file that was made in the background", "Keep a copy up to date", "FHIR"}
    assert set(BLOCK) == run
    assert PAGE.count("```") == 2 * len(BLOCKS) == 2 * len(run)


def test_token_is_read_and_stays_out_of_the_script(world):
    script = BLOCK["Scripts"][1].replace("http://127.0.0.1:8000", world.served.address)
    assert world.served.address in script
    script += 'curl -fsS -H "Authorization: Bearer $TADA_TOKEN" "$TADA_SERVER/v1/studies/pilot"'
    done = subprocess.run(
        ["bash", "-c", script], input=f"{world.token}\n", capture_output=True, text=True, timeout=60, check=False
    )
    assert '"code":"pilot"' in done.stdout, done.stderr


def test_curl_loads_what_the_pages_tell_and_pandas_joins_it_with_the_dictionary(world):
    assert len(world.records()) == 4
    world.run("curl")
    with (world.folder / "items.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert (len(rows), sum(float(row["energy_kcal"] or 0) for row in rows)) == world.expected()
    assert {row["participant"] for row in rows} == {"P001", "007"}
    loaded, (unit,) = world.loaded("Items beside the data dictionary")
    assert loaded == world.expected()
    assert unit == "kcal"


@pytest.mark.parametrize("heading", ["Python, pandas", "Python, polars", "R"])
def test_study_is_loaded_in_five_lines(world, heading):
    assert world.loaded(heading) == (world.expected(), [])
    loading, _, showing = BLOCK[heading][1].strip().partition("\n\n")
    assert len(loading.splitlines()) <= 5
    assert len(showing.splitlines()) == 1


def test_file_made_in_the_background_is_read(world):
    body = {"rows": "items", "format": "parquet", "components": "all"}
    require(world.served.admin.post("/v1/studies/pilot/exports", json=body))
    make_files(world.served)
    assert world.loaded("A file that was made in the background") == (world.expected(), [])


def test_fhir_search_finds_the_same_records_and_energy(world):
    world.run("FHIR")
    bundle = json.loads((world.folder / "bundle.json").read_text())
    found = {entry["resource"]["id"]: entry["resource"] for entry in bundle["entry"]}
    rows = {row["id"]: row for row in world.records() if row["participant"] == "P001"}
    assert set(found) == set(rows)
    for key, row in rows.items():
        labels = found[key].get("ingredientLabel", [])
        energies = [one["amount"]["value"] for one in labels if "ENERC_KCAL" in json.dumps(one["nutrient"])]
        assert energies == ([pytest.approx(row["energy_kcal"])] if row["energy_kcal"] is not None else [])


def test_copy_follows_what_is_added_changed_and_erased(world):
    heading = "Keep a copy up to date"
    assert world.loaded(heading) == (world.expected(), [])
    before = world.records()
    phone = world.phones["007"]
    world.served.send_meal(phone, found_item(40.0), hints=APPLE, captured_at="2026-11-17T12:30:00+08:00")
    gone, changed = (row for row in before if row["participant"] == "007")
    world.served.say(changed["meal_id"], "set_mass", item=changed["id"], mass_g=33.0)
    require(phone.delete(f"/v1/meals/{gone['meal_id']}"))
    assert {row["id"] for row in world.records()} != {row["id"] for row in before}
    assert world.loaded(heading) == (world.expected(), [])
    copy = json.loads((world.folder / "copy.json").read_text())
    assert set(copy["records"]) == {row["id"] for row in world.records()}
