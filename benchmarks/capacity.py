"""Machines and money for so many participants, worked out from what the other benchmarks showed: docs/capacity.md.

    python benchmarks/capacity.py [--participants 1000 100000 10000000] [--core-hour 0.04] [--blob-gb-month 0.02]
                                  [--meal-mb 8] [--meals-a-day 4] [--kept-days 30]

What was measured stands in MEASURED with where it comes from, what is assumed in ASSUMED: measure the first on your
machines, put in what you know of your participants.
"""

import argparse
import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Measured:
    """On two shared cores of a virtual machine, November 2026; seconds of one core.

    api: benchmarks/api.py, PostgreSQL and S3, pairs of 2 x 4 MB, 8 at once: 0.68 cores at 9.3 meals a second.
    poll: the same, GET /v1/meals/{id}. estimate: a pair of 12 megapixels, and what is not the pipeline (4.4 %).
    stores: PostgreSQL and the S3 server together, at most: what server and load left of the two cores in that run.
    run_mb: what an estimate leaves beside the photographs, most of it points and scene in 3D: a meal of the demo.
    record_bytes: benchmarks/query.py, ten million records with their meals, indexes and write-ahead log: 20 GB.
    """

    api: float = 0.073
    poll: float = 0.010
    estimate: float = 3.7
    stores: float = 0.137
    run_mb: float = 4.1
    record_bytes: int = 2_000


@dataclass(frozen=True, slots=True)
class Assumed:
    """busiest_hour: its share of a day's meals. minute: its busiest minute against its mean. use: of a core."""

    meals_a_day: float = 4
    items_a_meal: float = 3
    polls_a_meal: float = 3
    meal_mb: float = 8
    kept_days: float = 30
    busiest_hour: float = 1 / 6
    minute: float = 3
    use: float = 0.7
    core_hour: float = 0.04
    blob_gb_month: float = 0.02


@dataclass(frozen=True, slots=True)
class Need:
    """Of a deployment. Cores of workers for the busiest hour; of servers and stores for its busiest minute."""

    meals_a_second: float
    uplink_mbit: float
    api_cores: float
    worker_cores: float
    store_cores: float
    blobs_tb: float
    records_a_year: float
    database_gb_a_year: float
    dollars_a_month: float


def need(participants: float, measured: Measured, assumed: Assumed) -> Need:
    """What so many participants need on every day of the month."""
    meals_a_day = participants * assumed.meals_a_day
    hour = meals_a_day * assumed.busiest_hour / 3600
    minute = hour * assumed.minute
    api = minute * (measured.api + assumed.polls_a_meal * measured.poll) / assumed.use
    workers = hour * measured.estimate / assumed.use
    stores = minute * measured.stores / assumed.use
    blobs_gb = meals_a_day * (assumed.meal_mb + measured.run_mb) * assumed.kept_days / 1000
    records = meals_a_day * assumed.items_a_meal * 365
    cores = sum(max(1, math.ceil(each)) for each in (api, workers, stores))
    return Need(
        meals_a_second=minute,
        uplink_mbit=minute * assumed.meal_mb * 8,
        api_cores=api,
        worker_cores=workers,
        store_cores=stores,
        blobs_tb=blobs_gb / 1000,
        records_a_year=records,
        database_gb_a_year=records * measured.record_bytes / 1e9,
        dollars_a_month=cores * 730 * assumed.core_hour + blobs_gb * assumed.blob_gb_month,
    )


def main() -> None:
    assumed = Assumed()
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--participants", type=float, nargs="+", default=[1e3, 1e5, 1e7])
    for name in ("core_hour", "blob_gb_month", "meal_mb", "meals_a_day", "kept_days"):
        parser.add_argument(
            f"--{name.replace('_', '-')}", type=float, default=getattr(assumed, name)
        )
    given = vars(parser.parse_args())
    participants = given.pop("participants")
    needs = [need(count, Measured(), Assumed(**given)) for count in participants]
    print(f"| | {' | '.join(f'{count:,.0f}' for count in participants)} |")
    print(f"|{'---|' * (1 + len(needs))}")
    for words, field in (
        ("meals a second, busiest minute", "meals_a_second"),
        ("uplink then, Mbit/s", "uplink_mbit"),
        ("cores for API processes", "api_cores"),
        ("cores for workers, busiest hour", "worker_cores"),
        ("cores for PostgreSQL and S3, at most", "store_cores"),
        ("photographs and what is made of them kept, TB", "blobs_tb"),
        ("records a year", "records_a_year"),
        ("database, GB a year", "database_gb_a_year"),
        ("a month, dollars", "dollars_a_month"),
    ):
        print(f"| {words} | {' | '.join(_figure(getattr(one, field)) for one in needs)} |")


def _figure(value: float) -> str:
    """Two significant digits: no more is known."""
    digits = 1 - math.floor(math.log10(value)) if value else 0
    return f"{round(value, digits):,.{max(0, min(2, digits))}f}"


if __name__ == "__main__":
    main()
