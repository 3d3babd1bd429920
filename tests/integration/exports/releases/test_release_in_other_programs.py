"""A release's files in other programs: REDCap, SPSS and Stata, by the scripts of examples/."""

import csv
import re
import runpy
from datetime import date
from types import SimpleNamespace

import frictionless
import pandas as pd
import pyreadstat
import pytest

from tests.e2e.processes import REPOSITORY
from tests.integration.exports.releases import test_releases
from tests.integration.exports.releases.test_releases import fetch, frozen

eaten, owner = test_releases.eaten, test_releases.owner


@pytest.fixture
def release(owner, run, tmp_path):
    """A release's files in a folder, and a script run on it."""
    made = frozen(owner, run, "baseline")
    for file in made["files"]:
        (tmp_path / file["name"]).write_bytes(fetch(owner, made, file["name"]))

    def convert(script):
        runpy.run_path(str(REPOSITORY / "examples" / script), run_name="module")["main"](tmp_path)

    return SimpleNamespace(folder=tmp_path, convert=convert)


def read_csv(path):
    with path.open(newline="", encoding="utf-8") as file:
        rows = csv.DictReader(file)
        return rows.fieldnames, list(rows)


def errors(package):
    """What Frictionless finds in the CSV tables; its reader of Parquet has no bytes, and takes lists for text."""
    tables = [resource.to_descriptor() for resource in package.resources if resource.format == "csv"]
    report = frictionless.Package.from_descriptor({"resources": tables}, basepath=package.basepath).validate()
    return report.flatten(["name", "type"])


def test_release_is_a_data_package_whose_tables_are_as_it_says(release):
    path = release.folder / "datapackage.json"
    package = frictionless.Package(str(path))
    assert len(package.resources) == 2 * len(test_releases.TABLES) + 1
    assert errors(package) == []
    days = release.folder / "days.csv"
    days.write_text(days.read_text().replace("closed", "shut"))
    kinds = {kind for _, kind in errors(frictionless.Package(str(path)))}
    assert kinds >= {"hash-count", "constraint-error"}


def test_redcap_gets_a_field_for_each_column_and_a_repeat_for_each_day(release):
    release.convert("release_to_redcap.py")
    head, fields = read_csv(release.folder / "redcap_dictionary.csv")
    assert len(head) == 18
    names = [field["Variable / Field Name"] for field in fields]
    assert names[0] == "record_id"
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[a-z][a-z0-9_]{0,99}", name) for name in names)
    assert {field["Form Name"] for field in fields} == {"participant", "day"}
    status = fields[names.index("day_status")]
    assert (status["Field Type"], status[head[5]]) == ("dropdown", "open, open | closed, closed")
    assert fields[names.index("energy_kcal")]["Text Validation Type OR Show Slider Number"] == "number"

    columns, rows = read_csv(release.folder / "redcap_import.csv")
    assert columns == ["record_id", "redcap_repeat_instrument", "redcap_repeat_instance", *names[1:]]
    _, days = read_csv(release.folder / "days.csv")
    repeats = [row for row in rows if row["redcap_repeat_instrument"] == "day"]
    key = "record_id", "redcap_repeat_instance"
    assert len({tuple(row[name] for name in key) for row in repeats}) == len(repeats) == len(days) == 6
    for row, day in zip(repeats, days, strict=True):
        assert row["record_id"] == day["participant"]
        first = date(2000, 1, 1)
        assert int(row["redcap_repeat_instance"]) == (date.fromisoformat(day["local_date"]) - first).days + 1
        assert (row["local_date"], row["energy_kcal"]) == (day["local_date"], day["energy_kcal"])
        assert row["ate_nothing"] == {"True": "1", "False": "0"}[day["ate_nothing"]]
    assert sorted(row["record_id"] for row in rows if row not in repeats) == sorted(
        {day["participant"] for day in days}
    )


@pytest.mark.parametrize(("end", "read"), [("sav", pyreadstat.read_sav), ("dta", pyreadstat.read_dta)])
def test_spss_and_stata_have_the_values_of_the_release_and_labels(release, end, read):
    release.convert("release_to_stats.py")
    for table in ("participants", "days", "meals", "items"):
        frame, meta = read(release.folder / f"{table}.{end}")
        expected = pd.read_parquet(release.folder / f"{table}.parquet")
        assert list(frame.columns) == list(expected.columns)
        assert frame["participant"].tolist() == expected["participant"].tolist()
        if table != "participants":
            assert frame["energy_kcal"].tolist() == pytest.approx(expected["energy_kcal"].tolist(), nan_ok=True)
            assert meta.column_names_to_labels["energy_kcal"].startswith("[kcal] ")
    days, _ = read(release.folder / f"days.{end}")
    assert str(days["local_date"][0])[:10] == "2026-11-01"
