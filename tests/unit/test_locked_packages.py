"""The lock: every package that is installed, with the hashes of its files, and nothing that names where it is from."""

import json
import pathlib
import re
import tomllib

import pytest

from tools import audit_packages as audit

ROOT = pathlib.Path(__file__).parents[2]
ENTRY = re.compile(r"^([a-z0-9-]+)==([^ ;\\]+)", re.MULTILINE)


def locked(name):
    return dict(ENTRY.findall((ROOT / "tools" / "lock" / name).read_text()))


def asked(*extras):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = list(project["dependencies"]) + [line for each in extras for line in project["optional-dependencies"][each]]
    names = [re.fullmatch(r"([A-Za-z0-9._-]+)(?:\[\w+\])?==(\S+)", line) for line in lines]
    return {re.sub(r"[._-]+", "-", found[1]).lower(): found[2] for found in names}


def test_lock_has_what_the_project_asks_for_and_image_and_environment_install_by_it():
    assert asked().items() <= locked("runtime.txt").items()
    assert asked("dev").items() <= locked("dev.txt").items()
    assert locked("runtime.txt").items() <= locked("dev.txt").items()
    assert locked("build.txt").items() <= locked("dev.txt").items()
    assert "hatchling" in locked("build.txt")
    assert "hatchling" not in locked("runtime.txt")  # the image has nothing that only builds it
    image, make = (ROOT / "docker" / "Dockerfile").read_text(), (ROOT / "Makefile").read_text()
    for text, name in ((image, "runtime.txt"), (make, "runtime.txt"), (make, "dev.txt")):
        installs = re.findall(r"pip [^\n]*install[^\n]*", text)
        of_program = [line for line in installs if "--require-hashes" not in line and "uv==" not in line]
        of_program = [line for line in of_program if "/wheels/" not in line]
        assert any("--require-hashes" in line and name in line for line in installs)
        assert all("--no-deps" in line and "--no-build-isolation" in line for line in of_program), of_program


@pytest.mark.parametrize(("name", "least"), [("runtime.txt", 50), ("dev.txt", 100), ("build.txt", 2)])
def test_every_package_has_hashes_and_none_says_where_it_is_from(name, least):
    text = (ROOT / "tools" / "lock" / name).read_text()
    assert "://" not in text
    assert "index" not in text.replace("index-", "").split("--hash")[0]
    entries = re.split(r"(?m)^(?=[a-z0-9-]+==)", text)[1:]
    assert len(entries) >= least
    assert [entry.split()[0] for entry in entries if "--hash=sha256:" not in entry] == []


def answer(*packages):
    return json.dumps({"dependencies": list(packages), "fixes": []})


FAULT = {"id": "PYSEC-1", "aliases": ["CVE-2"], "fix_versions": ["2.0"], "description": ""}
SOUND, FAULTY = ({"name": name, "version": "1.0", "vulns": vulns} for name, vulns in (("a", []), ("b", [FAULT])))
SKIPPED = {"name": "c", "skip_reason": "not found"}


@pytest.mark.parametrize(
    ("printed", "excuses", "code", "words"),
    [
        (answer(SOUND), (), 0, "1 of 1 packages audited: 0 known faults"),
        (answer(SOUND, FAULTY), (), 1, "b 1.0: PYSEC-1, mended in 2.0"),
        (answer(SOUND, FAULTY), ("CVE-2",), 0, "0 known faults"),
        (answer(SKIPPED), (), 0, "packages not audited"),
        ("", (), 0, "packages not audited"),
        ("Usage: pip-audit", (), 1, "could not be audited"),
    ],
)
def test_known_fault_fails_and_a_list_that_is_not_reached_is_told(capsys, printed, excuses, code, words):
    said = "error: no such option" if printed.startswith("Usage") else "requests.exceptions.ConnectionError: no route"
    assert audit.judge(printed, said, frozenset(excuses)) == code
    assert words in capsys.readouterr().out
