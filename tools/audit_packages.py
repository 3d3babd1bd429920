"""Known faults of the packages that the image has, by pip-audit. Says so, and passes, where no list of them is reached.

    python tools/audit_packages.py [LOCK]

A fault that does us no harm is excused by a line of tools/known-faults.txt: its id, and after a # why.
"""

import json
import re
import subprocess
import sys
import tempfile
import venv
from collections.abc import Sequence
from pathlib import Path

TOOLS = Path(__file__).parent
LOCK = TOOLS / "lock" / "runtime.txt"
PIP_AUDIT = "pip-audit==2.10.1"
FAULTS = TOOLS / "known-faults.txt"
AWAY = re.compile(r"ConnectionError|ConnectTimeout|ReadTimeout|Timeout|resolve|ProxyError|SSLError")


def main(lock: Path) -> int:
    """1 where a package has a known fault that is not excused, else 0."""
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        programs = Path(folder) / "bin"
        if (
            run(
                [programs / "pip", "install", "--quiet", "--disable-pip-version-check", PIP_AUDIT]
            ).returncode
            != 0
        ):
            return not_audited("pip-audit could not be installed")
        found = run(
            [
                programs / "pip-audit",
                *("--disable-pip", "--require-hashes", "--requirement", lock, "--format", "json"),
                *("--progress-spinner", "off", "--timeout", "20"),
            ]
        )
    return judge(found.stdout, found.stderr, excused(FAULTS))


def judge(printed: str, said: str, excuses: frozenset[str]) -> int:
    """The exit code that pip-audit's JSON comes to. said: what it wrote to standard error."""
    try:
        packages = json.loads(printed)["dependencies"]
    except (ValueError, KeyError):
        if AWAY.search(said):
            return not_audited(
                f"the list of known faults cannot be reached ({said.strip()[-200:]})"
            )
        print(f"packages could not be audited: {said.strip()[-500:]}")
        return 1
    looked_up = [package for package in packages if "skip_reason" not in package]
    if not looked_up:
        return not_audited(
            "the list of known faults knows none of the packages: it cannot be reached from here"
        )
    faults = [
        f"{package['name']} {package['version']}: {fault['id']}, mended in {', '.join(fault['fix_versions']) or 'none'}"
        for package in looked_up
        for fault in package["vulns"]
        if not excuses & {fault["id"], *fault["aliases"]}
    ]
    print(
        *faults,
        f"{len(looked_up)} of {len(packages)} packages audited: {len(faults)} known faults",
        sep="\n",
    )
    return 1 if faults else 0


def not_audited(why: str) -> int:
    """Say so: nobody should take this for a clean bill."""
    print(f"packages not audited: {why}")
    return 0


def excused(listed: Path) -> frozenset[str]:
    """The ids of known faults that do us no harm. Ends the program for one without its reason."""
    lines = [line.partition("#") for line in listed.read_text().splitlines()]
    for fault, _, reason in lines:
        if fault.strip() and not reason.strip():
            sys.exit(f"{listed}: say behind a # why {fault.strip()} does no harm.")
    return frozenset(fault.strip() for fault, _, _ in lines) - {""}


def run(command: Sequence[str | Path]) -> subprocess.CompletedProcess[str]:
    """A command's end and what it printed."""
    return subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, check=False
    )


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else LOCK))
