"""Mutants of app/, to see what the tests notice. Each command can be stopped and run again: it goes on where it was.

    python -m tools.mutants draw RECORD --checkout DIR --seed 39     five of each package that RECORD's tests kill
    python -m tools.mutants run RECORD DRAWN --checkout DIR          the same mutants against other tests
    python -m tools.mutants table RESULTS                            a table for people

RECORD is a folder that `make test-times COVERAGE=RECORD` wrote in a checkout of the commit of DIR. A mutant runs in
a copy of DIR against the tests that run its lines, the quickest first, then against the others of their files (which
may share a fixture), until one fails or the time is over.
"""

import argparse
import collections
import functools
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import coverage

from tools.coverage_of_processes import DATA, OF_CHILD
from tools.mutations import Mutation, mutations

PACKAGES = (
    "records",
    "meals",
    "uploads",
    "jobs",
    "nutrition",
    "foods",
    "privacy",
    "exports",
    "people/access",
    "storage",
    "estimates",
    "vision/solids",
)
DRAWN_OF_PACKAGE = 5
DRAW_SECONDS, RUN_SECONDS = 80.0, 1200.0  # of tests against one mutant
BATCH_SECONDS = (
    4.0,
    20.0,
    60.0,
    120.0,
)  # recorded seconds of the tests of one pytest; the last of all further ones
START_SECONDS = 120.0  # of a pytest, beside its tests
SLOWER = 4.0  # than recorded: a busy machine
TIMES, COMBINED, RESULTS = "times.jsonl", "coverage", "mutants.jsonl"
FAILED, NO_SUCH_TEST = (1, 2, 3), 4  # exit codes of pytest; 2 and 3: it could not even be imported


@dataclass(frozen=True, slots=True)
class Mutant:
    """file: relative to the checkout. line: its text, by which it is found again in another commit."""

    package: str
    file: str
    number: int
    line: str
    mutation: Mutation
    before: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """killed_by: the first failed test or group; None: none failed."""

    mutant: Mutant
    killed_by: str | None
    tests: int
    is_complete: bool


class Recorded:
    """Which tests run which lines, and how long they take."""

    def __init__(self, folder: Path) -> None:
        combined = folder / COMBINED
        if not combined.exists():
            recording = coverage.Coverage(data_file=str(combined), config_file=False)
            recording.combine([str(folder / DATA)], keep=True)
            recording.save()
        self._data = coverage.CoverageData(str(combined))
        self._data.read()
        self._files = {name.partition("/app/")[2]: name for name in self._data.measured_files()}
        self.seconds: dict[str, float] = collections.defaultdict(float)
        failed = set()
        for line in (folder / TIMES).read_text().splitlines():
            row = json.loads(line)
            self.seconds[row["test"]] += row["seconds"]
            if row["outcome"] != "passed":
                failed.add(row["test"])
        for test in failed:  # a test that fails, or is skipped, without a mutant shows nothing
            del self.seconds[test]
        self._by_file = collections.defaultdict(list)
        for test in self.seconds:
            self._by_file[test.partition("::")[0]].append(test)

    def tests_of(self, file: str, lines: tuple[int, int]) -> list[str]:
        """Return tests that run any of these lines, quickest first, then the others of their files.

        Of lines that run at import alone (constants, models): those that run any line of a function of the file.
        """
        by_line = self._contexts(file)
        covering = _tests(by_line, range(lines[0], lines[1] + 1)) or _tests(by_line, by_line)
        quickest = sorted(covering & self.seconds.keys(), key=self.seconds.__getitem__)
        beside = {
            test
            for name in {test.partition("::")[0] for test in covering}
            for test in self._by_file[name]
        }
        return quickest + sorted(beside - covering, key=self.seconds.__getitem__)

    @functools.cache  # noqa: B019  # one object per run of the command
    def _contexts(self, file: str) -> dict[int, list[str]]:
        name = self._files.get(file.removeprefix("app/"))
        return {} if name is None else self._data.contexts_by_lineno(name)


def _tests(by_line: dict[int, list[str]], lines: Iterable[int]) -> set[str]:
    return {
        context.removeprefix(OF_CHILD)
        for line in lines
        for context in by_line.get(line, [])
        if context
    }


def candidates(checkout: Path, package: str, seed: int) -> Iterator[Mutant]:
    """Yield the mutants of a package in the seed's order."""
    drawn = []
    for path in sorted((checkout / "app" / package).rglob("*.py")):
        source = path.read_bytes()
        lines = source.decode().splitlines()
        for mutation in mutations(source):
            number = mutation.lines[0]
            before = source[mutation.start : mutation.end].decode()
            file = path.relative_to(checkout).as_posix()
            drawn.append(Mutant(package, file, number, lines[number - 1], mutation, before))
    random.Random(f"{seed} {package}").shuffle(drawn)  # noqa: S311
    yield from drawn


class Workshop:
    """A copy of the checkout, in which one mutant at a time is tested."""

    def __init__(self, checkout: Path, recorded: Recorded) -> None:
        self._recorded = recorded
        self._folder = Path(tempfile.mkdtemp(prefix="tada-mutants-")) / "checkout"
        ignored = shutil.ignore_patterns(".git", ".venv", "*_cache", "node_modules", "demo-output")
        shutil.copytree(checkout, self._folder, ignore=ignored)

    def test(self, mutant: Mutant, tests: Sequence[str], seconds: float) -> Outcome:
        """Test the mutant until a test fails or the recorded seconds of the tests come to `seconds`."""
        path = self._folder / mutant.file
        source = path.read_bytes()
        path.write_bytes(mutant.mutation.apply(source))
        ran = 0
        try:
            for batch in _batches(tests, self._recorded.seconds, seconds):
                failed = self._run(batch)
                ran += len(batch)
                if failed:
                    return Outcome(mutant, failed, ran, is_complete=True)
        finally:
            path.write_bytes(source)
        return Outcome(mutant, None, ran, is_complete=ran == len(tests))

    def close(self) -> None:
        """Delete the copy."""
        shutil.rmtree(self._folder.parent)

    def _run(self, tests: Sequence[str]) -> str | None:
        """Return the first test that fails, or how pytest ended; None if all pass."""
        listed = self._folder.parent / "tests.txt"
        listed.write_text("\n".join(tests))
        environment = os.environ | {
            "PYTHONPATH": str(self._folder),
            # else a mutant of the same second and size would be taken for its source
            "PYTHONDONTWRITEBYTECODE": "1",
            "TADA_SHARED_DATA": os.environ.get(
                "TADA_SHARED_DATA", str(Path.cwd().parent / "shared")
            ),
        }
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-x",
            "-q",
            "--no-header",
            "--tb=no",
            "-p",
            "no:cacheprovider",
        ]
        process = subprocess.Popen(
            [*command, f"@{listed}"],
            cwd=self._folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )
        limit = START_SECONDS + SLOWER * sum(self._recorded.seconds[test] for test in tests)
        try:
            printed, _ = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGTERM)
            process.communicate()
            return "no end"
        if process.returncode not in FAILED:
            if process.returncode == NO_SUCH_TEST:
                raise SystemExit(f"the record is of other tests:\n{printed[-2000:]}")
            return None
        failed = [line for line in printed.splitlines() if line.startswith(("FAILED ", "ERROR "))]
        return failed[0].split(" ")[1] if failed else "no test could run"


def _batches(
    tests: Sequence[str], seconds_of: dict[str, float], seconds: float
) -> Iterator[list[str]]:
    """Yield tests in their order, few first: the quickest usually suffice, and each pytest takes seconds to start."""
    limits = iter(BATCH_SECONDS)
    batch: list[str] = []
    limit, taken = next(limits), 0.0
    for test in tests:
        if batch and taken + seconds_of[test] > limit:
            yield batch
            seconds -= taken
            limit, batch, taken = next(limits, BATCH_SECONDS[-1]), [], 0.0
        if taken + seconds_of[test] > seconds:
            break
        batch.append(test)
        taken += seconds_of[test]
    if batch:
        yield batch


def moved(mutant: Mutant, checkout: Path) -> Mutant | None:
    """Return the mutant in another commit, by its line's text; None if the line is no longer there."""
    path = checkout / mutant.file
    if not path.exists():
        return None
    source = path.read_bytes()
    lines = source.decode().splitlines()
    same = [
        each
        for each in mutations(source)
        if (each.rule, each.replacement) == (mutant.mutation.rule, mutant.mutation.replacement)
        and source[each.start : each.end].decode() == mutant.before
        and lines[each.lines[0] - 1] == mutant.line
    ]
    if not same:
        return None
    nearest = min(same, key=lambda each: abs(each.start - mutant.mutation.start))
    return replace(mutant, number=nearest.lines[0], mutation=nearest)


def draw(arguments: argparse.Namespace) -> None:
    """Draw mutants that the recorded tests kill, the same number of each package."""
    recorded = Recorded(arguments.record)
    results = arguments.record / RESULTS
    known = {_key(outcome.mutant): outcome for outcome in read_outcomes(results)}
    packages = collections.deque(PACKAGES)

    def work() -> None:
        shop = Workshop(arguments.checkout, recorded)
        try:
            while packages:
                _draw_package(packages.popleft(), arguments, recorded, shop, known, results)
        except IndexError:  # another one took the last package
            pass
        finally:
            shop.close()

    _side_by_side(work, arguments.processes)


def _draw_package(
    package: str,
    arguments: argparse.Namespace,
    recorded: Recorded,
    shop: Workshop,
    known: dict[str, Outcome],
    results: Path,
) -> None:
    killed = 0
    for mutant in candidates(arguments.checkout, package, arguments.seed):
        outcome = known.get(_key(mutant))
        if outcome is None:
            outcome = shop.test(
                mutant, recorded.tests_of(mutant.file, mutant.mutation.lines), DRAW_SECONDS
            )
            write_outcome(results, outcome)
        killed += outcome.killed_by is not None
        if killed == DRAWN_OF_PACKAGE:
            return


def run(arguments: argparse.Namespace) -> None:
    """Test the drawn mutants: first by the gate's tests, then by the others."""
    recorded = Recorded(arguments.record)
    gate = collected(arguments.checkout, "not slow")
    results = arguments.record / RESULTS
    done = {_key(outcome.mutant) for outcome in read_outcomes(results)}
    waiting = collections.deque(
        outcome.mutant
        for outcome in read_outcomes(arguments.drawn)
        if outcome.killed_by is not None and _key(outcome.mutant) not in done
    )

    def work() -> None:
        shop = Workshop(arguments.checkout, recorded)
        try:
            while waiting:
                _run_mutant(waiting.popleft(), arguments.checkout, recorded, gate, shop, results)
        except IndexError:
            pass
        finally:
            shop.close()

    _side_by_side(work, arguments.processes)


def _run_mutant(
    drawn: Mutant, checkout: Path, recorded: Recorded, gate: set[str], shop: Workshop, results: Path
) -> None:
    mutant = moved(drawn, checkout)
    if mutant is None:
        write_outcome(results, Outcome(drawn, "the line is gone", 0, is_complete=True))
        return
    tests = recorded.tests_of(mutant.file, mutant.mutation.lines)
    outcome = shop.test(mutant, [test for test in tests if test in gate], RUN_SECONDS)
    if outcome.killed_by is None:
        beyond = shop.test(mutant, [test for test in tests if test not in gate], RUN_SECONDS)
        killed_by = None if beyond.killed_by is None else f"beyond the gate: {beyond.killed_by}"
        outcome = Outcome(mutant, killed_by, outcome.tests + beyond.tests, beyond.is_complete)
    write_outcome(results, replace(outcome, mutant=drawn))


def collected(checkout: Path, marks: str) -> set[str]:
    """Return the ids of the tests with these marks."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-m", marks]
    printed = subprocess.run(
        command, cwd=checkout, capture_output=True, text=True, check=True
    ).stdout
    return {line for line in printed.splitlines() if "::" in line}


def _side_by_side(work: Callable[[], None], processes: int) -> None:
    with ThreadPoolExecutor(processes) as pool:
        for future in [pool.submit(work) for _ in range(processes)]:
            future.result()


def read_outcomes(path: Path) -> list[Outcome]:
    """Read what was written so far; nothing if there is no file yet."""
    outcomes = []
    for line in path.read_text().splitlines() if path.exists() else []:
        fields = json.loads(line)
        mutation = fields["mutant"].pop("mutation")
        mutation["lines"] = tuple(mutation["lines"])
        outcomes.append(
            Outcome(Mutant(**fields.pop("mutant"), mutation=Mutation(**mutation)), **fields)
        )
    return outcomes


def write_outcome(path: Path, outcome: Outcome) -> None:
    """Add one line to the file and print one."""
    with path.open("a") as file:
        file.write(json.dumps(asdict(outcome)) + "\n")
    mutant = outcome.mutant
    change = f"{mutant.before!r} -> {mutant.mutation.replacement!r}"
    print(
        f"{mutant.file}:{mutant.number} {change[:80]}: {outcome.killed_by or 'NOT KILLED'}",
        flush=True,
    )


def print_table(arguments: argparse.Namespace) -> None:
    """Print the results by package, and each mutant that the gate missed."""
    outcomes = read_outcomes(arguments.results)
    print(
        "| package | mutants | killed by the gate | beyond it | not killed |\n|---|---|---|---|---|"
    )
    for package in PACKAGES:
        mine = [outcome for outcome in outcomes if outcome.mutant.package == package]
        lost = sum(outcome.killed_by is None for outcome in mine)
        beyond = sum((outcome.killed_by or "").startswith("beyond") for outcome in mine)
        print(f"| {package} | {len(mine)} | {len(mine) - lost - beyond} | {beyond} | {lost} |")
    for outcome in outcomes:
        if outcome.killed_by is None or outcome.killed_by.startswith("beyond"):
            mutant = outcome.mutant
            print(
                f"- {mutant.file}:{mutant.number} `{mutant.line.strip()}`: {mutant.before!r} -> "
                f"{mutant.mutation.replacement!r}: {outcome.killed_by or 'not killed'}"
            )


def _key(mutant: Mutant) -> str:
    return f"{mutant.file}:{mutant.mutation.start}:{mutant.mutation.rule}:{mutant.mutation.replacement}"


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)
    for command in (draw, run):
        sub = commands.add_parser(command.__name__, help=command.__doc__)
        sub.set_defaults(command=command)
        sub.add_argument("record", type=Path)
        if command is run:
            sub.add_argument("drawn", type=Path)
        else:
            sub.add_argument("--seed", type=int, required=True)
        sub.add_argument("--checkout", type=Path, default=Path.cwd())
        sub.add_argument("--processes", type=int, default=2)
    sub = commands.add_parser("table", help=print_table.__doc__)
    sub.set_defaults(command=print_table)
    sub.add_argument("results", type=Path)
    arguments = parser.parse_args()
    arguments.command(arguments)


if __name__ == "__main__":
    main()
