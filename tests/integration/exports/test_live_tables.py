"""The live tables: all of one moment, while others write; one study's alone for `tada sql`."""

import json
import os
import subprocess
import sys

import pytest

from app.db.session import normalise_url
from app.file_worker import without_values
from tests.integration.diary.eaten_days import add_meal, eaten_item

READER = """
import json, sys
from pathlib import Path
from app.exports.export_spec import ExportSpec
from app.exports.live_tables import live_tables
from app.exports.table_selects import Scope, select_table
from app.exports.write_table import write_table

url, folder = sys.argv[1], Path(sys.argv[2])
with live_tables(url, folder) as connection:
    for rows in ("items", "meals", "days"):
        table = select_table(connection, ExportSpec(rows), Scope())
        print(write_table(connection, table, "csv", folder / rows), flush=True)
        sys.stdin.readline()
"""


@pytest.mark.both_stores
def test_all_tables_are_of_one_moment_while_others_write(state, enrol, tmp_path):
    enrol("P001")
    add_meal(state, "P001", "2026-11-01", eaten_item(100.0, "apple"))
    program = [sys.executable, "-c", READER, state.database.url, str(tmp_path)]
    with subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as reader:
        counts = [int(reader.stdout.readline())]
        for day in ("2026-11-02", "2026-11-03"):
            add_meal(state, "P001", day, eaten_item(50.0, "banana"))
            reader.stdin.write("\n")
            reader.stdin.flush()
            counts.append(int(reader.stdout.readline()))
    assert counts == [1, 1, 1]


@pytest.mark.both_stores
def test_command_queries_the_tables_of_one_study_and_changes_nothing(state, enrol):
    enrol("P001")
    add_meal(state, "P001", "2026-11-01", eaten_item(100.0, "apple", energy_kcal=52.0))
    url = normalise_url(state.database.url)

    def sql(*arguments):  # in a process that has not opened the database
        command = [sys.executable, "-m", "app.cli", "sql", *arguments]
        environment = os.environ | {"TADA_DATABASE_URL": url}
        ended = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=False)
        return ended.returncode, ended.stdout

    query = "SELECT participant, energy_kcal FROM days ORDER BY 1"
    assert sql(query) == (0, "participant,energy_kcal\nP001,52.0\n")
    assert sql("--study", "pilot", query) == (0, "participant,energy_kcal\nP001,52.0\n")
    assert sql("--study", "other", query) == (0, "participant,energy_kcal\n")
    assert sql("SELECT count(*) AS foods FROM components WHERE tagname = 'FE'") == (0, "foods\n1\n")
    assert sql("DELETE FROM live.study")[0] == 2


def test_error_tells_neither_the_password_nor_a_value(tmp_path):
    url = "postgresql+psycopg://tada:s3cret@127.0.0.1:1/tada"
    message = {"task": "export", "database_url": url, "folder": str(tmp_path), "request": {}}
    program = f"import json; from app.file_worker import answer_to; print(json.dumps(answer_to({message!r})))"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    error = json.loads(ended.stdout)["error"]
    assert error["kind"] == "unavailable"
    assert "s3cret" not in ended.stdout + ended.stderr
    assert without_values(ValueError("no 'P001' in \"x\"\nLINE 1: P001")) == "ValueError: no ... in ..."
