"""One run: a deployment, its phones, its faults, then the checks; and the table that tells what came of it."""

import pathlib
import random
import time
from dataclasses import dataclass

from tests.e2e.faults.deployment import Deployment
from tests.e2e.faults.invariants import Checker
from tests.e2e.faults.phones import Journal, Phone, plan_meals
from tests.e2e.faults.schedule import Schedule
from tests.e2e.faults.witness import Witness

PHONES = 4
LONGEST_STORM_SECONDS = 7200
CALM_SECONDS = 180.0  # after the last fault all meals have their answer by then; far more than it takes
PAIR = pathlib.Path(__file__).parents[3] / "app" / "demo_data"


@dataclass(frozen=True)
class Outcome:
    """What came of a storm. lost, duplicated, others: sentences; empty is good."""

    lost: list
    duplicated: list
    others: list
    table: str
    injected: dict


def storm(folder, database, store, *, seed, meals, rounds, longest_gap):
    """Run it. The seed draws meals and faults; when they meet is up to the machine."""
    real_pair = {slot: (PAIR / f"{slot}.jpg").read_bytes() for slot in ("left", "right")}
    rng = random.Random(seed)
    planned = plan_meals(rng, meals, real_pair)
    deployment = Deployment(folder, database, store)
    try:
        tokens = deployment.enrol([f"P{number}" for number in range(PHONES)])
        settings = deployment.settings
        journal, witness = Journal(), Witness(settings.resolved_database_url)
        began = time.monotonic()
        phones = [
            Phone(code, token, deployment.addresses, planned[place::PHONES], journal, random.Random(seed + 1 + place))
            for place, (code, token) in enumerate(tokens.items())
        ]
        schedule = Schedule(deployment, witness, random.Random(seed), rounds=rounds, longest_gap=longest_gap)
        witness.start()
        for phone in phones:
            phone.deadline = began + LONGEST_STORM_SECONDS
            phone.start()
        schedule.start()
        try:
            for phone in phones:
                phone.join()
            schedule.join()
        finally:
            schedule.stop()
            deployment.heal()
            stormed = time.monotonic() - began
            checker = Checker(settings, journal)
            calm = wait_for_calm(checker)
            witness.stop()
        ends = {program.name: program.ends for program in [*deployment.apis, *deployment.workers]}
        deployment.manager.close_but(deployment.database, deployment.store)
        try:
            lost, duplicated, others = checker.problems(deployment.logs())
        finally:
            checker.close()
        others += [f"{phone.name}: {phone.trouble!r}" for phone in phones if phone.trouble is not None]
        others += [f"refused: {words}" for words in journal.refused]
        others += [f"the job {job} of a dead worker was never taken over" for job in witness.waiting()]
        if "0 differ" not in (rebuilt := deployment.tada("records", "rebuild", "--check")):
            others.append(f"records are not what their runs say: {rebuilt}")
        table = describe(deployment, journal, witness, schedule, checker, lost, duplicated, stormed, calm, ends)
        return Outcome(lost, duplicated, others, table, dict(schedule.injected))
    finally:
        deployment.close()


def wait_for_calm(checker):
    """Seconds until no meal waits any more, at most CALM_SECONDS."""
    began = time.monotonic()
    while time.monotonic() - began < CALM_SECONDS:
        try:
            if not checker.waiting():
                break
        except Exception:  # noqa: BLE001  # the database is just being started
            pass
        time.sleep(0.2)
    return time.monotonic() - began


def describe(deployment, journal, witness, schedule, checker, lost, duplicated, stormed, calm, ends):
    """The table, as docs/faults.md has it."""
    longest = max((one.seconds for one in witness.takeovers), default=0.0)
    alone = [one.seconds for one in witness.takeovers if len(one.beside) <= 1]
    disk = "a full tmpfs" if deployment.disks["files"].is_mounted else "fsync that says so (no mount allowed)"
    rows = [(name, count) for name, count in sorted(schedule.injected.items())]
    rows += [
        ("faults injected", schedule.injected.total()),
        ("disk full by", disk),
        ("meals acknowledged", len(journal.acknowledged)),
        ("after-meal pairs acknowledged", len(journal.after_acknowledged)),
        ("meals erased", len(journal.erased)),
        ("tries of the phones", journal.tries),
        ("lost", len(lost)),
        ("duplicated", len(duplicated)),
        ("jobs taken over", len(witness.takeovers)),
        ("longest takeover, s", f"{longest:.1f}"),
        ("longest takeover without another fault, s", f"{max(alone, default=0.0):.1f}"),
        ("longest without a 2xx, s", f"{journal.longest_without_answer:.1f}"),
        ("orphan blobs deleted at the end", checker.orphans),
        ("ends that nobody asked for", sum(len(one) for one in ends.values())),
        ("storm, s", f"{stormed:.0f}"),
        ("from the last fault to the last answer, s", f"{calm:.1f}"),
    ]
    width = max(len(str(name)) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in rows)
