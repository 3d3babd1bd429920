"""docs/walk-through.md, run word for word: from a study to a withdrawal."""

import json
import re
import zipfile

import pytest

from tests.e2e.documents import BLOCK, run_blocks
from tests.e2e.processes import REPOSITORY, Server


@pytest.mark.slow
def test_study_from_its_first_day_to_a_withdrawal(tmp_path):
    server = Server(tmp_path)
    server.place_prepared_database()
    server.start()
    try:
        server.wait_until_ready()
        blocks = BLOCK.findall((REPOSITORY / "docs" / "walk-through.md").read_text())
        assert len(blocks) >= 12
        done = run_blocks(server, tmp_path, blocks)
        assert done.returncode == 0, done.stderr + done.stdout[-3000:] + server.log
        check_the_meal(json.loads((tmp_path / "meal.json").read_text()))
        check_the_records(json.loads((tmp_path / "records.json").read_text())["items"])
        check_what_is_left(tmp_path, done.stdout)
    finally:
        server.stop()


def check_the_meal(meal):
    apple = next(item for item in meal["items"] if item["food"]["key"] == "apple")
    assert (meal["after"]["status"], apple["status"], apple["provisional"]) == ("estimated", "confirmed", False)
    assert apple["left_g"] > 0.8 * apple["edible_g"]
    low, high = apple["consumed_interval_g"]
    assert low < 0 < high  # the same apple, before and after


def check_the_records(records):
    apple, honey = sorted(records, key=lambda record: record["origin"], reverse=True)
    assert (apple["origin"], honey["origin"]) == ("pipeline", "added")
    assert (honey["status"], honey["consumed_g"], honey["volume_ml"]) == ("confirmed", 20.0, None)
    assert {record["day_status"] for record in records} == {"closed"}
    assert {record["study_day"] for record in records} == {1}


def check_what_is_left(folder, printed):
    assert json.loads((folder / "gone.json").read_text())["code"] == "withdrawn"
    assert re.search(r"}410$", printed, re.MULTILINE)
    assert json.loads((folder / "none.json").read_text())["items"] == []
    assert "P007" not in (folder / "audit.json").read_text()
    with zipfile.ZipFile(folder / "my-data.zip") as archive:
        assert {"data.json", "README.txt"} <= set(archive.namelist())
        data = archive.read("data.json").decode()
    assert "P007" in data
    assert "13.4" in data
    assert "13.404954" not in data  # the study rounds places to two decimals
