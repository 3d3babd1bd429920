"""Write docs/tests.md: what the tests take, by folder, and the slowest: `python tools/test_times.py TIMES SECONDS`.

TIMES: what record_tests.py wrote. SECONDS: of the whole run, by the clock. The tables are made anew; the text above
them stays as it is.
"""

import json
import os
import sys
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "tests.md"
TABLES = "<!-- from here on made by `make test-times` -->\n"
PHASES = ("setup", "call", "teardown")
SLOWEST = 15
LEAST_SECONDS = 10.0  # of a folder that has a line of its own


@dataclass(slots=True)
class Taken:
    """Seconds by phase, and how many tests took them."""

    tests: int = 0
    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(PHASES, 0.0))

    @property
    def total(self) -> float:
        """Seconds of all phases."""
        return sum(self.seconds.values())


def main(times: Path, seconds: float) -> None:
    """Replace the tables of the page."""
    by_folder: dict[str, Taken] = defaultdict(Taken)
    by_test: dict[str, Taken] = defaultdict(Taken)
    for line in times.read_text().splitlines():
        row = json.loads(line)
        if row["when"] not in PHASES:  # its worker died
            continue
        folder = "/".join(row["test"].partition("::")[0].split("/")[1:-1][:2])
        for taken in (by_folder[folder], by_test[row["test"]]):
            taken.seconds[row["when"]] += row["seconds"]
        by_folder[folder].tests += row["when"] == "call"
    text, _, _ = PAGE.read_text().partition(TABLES)
    PAGE.write_text(text + TABLES + tables(by_folder, by_test, seconds))


def tables(by_folder: dict[str, Taken], by_test: dict[str, Taken], seconds: float) -> str:
    """Return both tables as Markdown."""
    whole = together(by_folder.values())
    large = {name: taken for name, taken in by_folder.items() if taken.total >= LEAST_SECONDS}
    small = [taken for name, taken in by_folder.items() if name not in large]
    load = ", ".join(f"{load:.1f}" for load in os.getloadavg())
    run = f"{whole.tests:,} tests in {seconds / 60:.1f} minutes on {os.cpu_count()} cores"
    lines = [
        "",
        f"{run}; load of the machine at the end: {load}.",
        "",
        "| folder | tests | setup, s | call, s | teardown, s |",
        "|---|---|---|---|---|",
        *(row(name, taken) for name, taken in by_size(large)),
        row(f"{len(small)} others", together(small)),
        row("all", whole),
        "",
        "| slowest tests | setup, s | call, s | teardown, s |",
        "|---|---|---|---|",
    ]
    for name, taken in by_size(by_test)[:SLOWEST]:
        lines.append(f"| `{name.removeprefix('tests/')}` | {phases(taken)} |")
    return "\n".join(lines) + "\n"


def together(parts: Iterable[Taken]) -> Taken:
    """Return the sums of several."""
    whole = Taken()
    for part in parts:
        whole.tests += part.tests
        for phase in PHASES:
            whole.seconds[phase] += part.seconds[phase]
    return whole


def by_size(taken: dict[str, Taken]) -> list[tuple[str, Taken]]:
    """Return names with what they took, the most first."""
    return sorted(taken.items(), key=lambda named: -named[1].total)


def row(name: str, taken: Taken) -> str:
    """Return one line of the folders' table."""
    return f"| {name} | {taken.tests:,} | {phases(taken)} |"


def phases(taken: Taken) -> str:
    """Return the seconds by phase, as cells."""
    return " | ".join(f"{taken.seconds[phase]:.1f}" for phase in PHASES)


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]))
