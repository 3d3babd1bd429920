"""How long one region takes in a study that has learned thousands of foods, and what memory its index takes.

    python benchmarks/index_at_scale.py [--entries 200000] [--foods 5000] [--kind sqlite]

--kind: sqlite, or postgresql, of our own, which ends with the run

Made-up foods: each has a middle between two examples of the shipped index, and items around it, apart as two examples
of a food are. Printed, on one thread:

1. the first read of the study's entries, and the process's memory before, at its peak and after;
2. the meal after that, one after a food was named anew, and one after an erasure: until the identifier is there;
3. the identification of one region (target, with the 18 ms of its description: 30 ms);
4. how many of the 256 nearest examples are among those that the leading axes preselect.
"""

import argparse
import multiprocessing
import os
import resource
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np  # after the number of threads
import sqlalchemy as sa

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from app.candidates.identify import LearnedIndex  # noqa: E402  # found from the checkout
from app.db.migrate import upgrade  # noqa: E402
from app.db.session import Database  # noqa: E402
from app.identification.food_index import shipped_index  # noqa: E402
from app.identification.identifier import Circumstances, Identifier  # noqa: E402
from app.identification.kernel_classifier import NEAREST  # noqa: E402
from app.meals.stored.identification_models import IndexEntry, ItemIdentification  # noqa: E402
from app.meals.stored.models import Meal  # noqa: E402
from app.meals.stored.record_models import EffectiveRecord  # noqa: E402
from app.people.models import Study  # noqa: E402
from app.people.privacy_models import Tombstone  # noqa: E402
from app.people.tombstones import public_digest  # noqa: E402
from app.vision.looks.vcm import VCM_VERSION  # noqa: E402
from benchmarks.databases import database_url  # noqa: E402
from benchmarks.query_data import ONE_STUDY, fill  # noqa: E402

PART = 2000
WITHIN = 0.7  # of the difference of two examples: how far an item is from its food's middle
ASKED = 100  # regions
NOW = datetime(2026, 12, 31, tzinfo=UTC)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--entries", type=int, default=200_000)
    parser.add_argument("--foods", type=int, default=5_000)
    parser.add_argument("--kind", choices=("sqlite", "postgresql"), default="sqlite")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder, database_url(options.kind, Path(folder)) as url:
        database = Database(url)
        upgrade(database)
        fill(database, round(options.entries / 0.9), 0, shape=ONE_STUDY)
        learn(database, options.entries, options.foods)
        database.dispose()
        fresh = multiprocessing.get_context("spawn").Process(
            target=measure, args=(url, options.foods)
        )
        fresh.start()
        fresh.join()
    return 0


def regions(count: int, foods: int, seed: int) -> Iterator[tuple[int, np.ndarray]]:
    """Foods and vectors, (1651,) float16, at random."""
    metric, examples, labels = (
        shipped_index().metric,
        shipped_index().examples,
        shipped_index().labels,
    )
    back, fixed = np.linalg.pinv(metric.axes), np.random.default_rng(0)
    pairs = fixed.integers(0, len(examples), (2, 200_000))
    one, other = pairs[:, (labels[pairs[0]] == labels[pairs[1]]) & (pairs[0] != pairs[1])]
    share, ends = fixed.random((foods, 1)), fixed.integers(0, len(examples), (2, foods))
    middles = share * examples[ends[0]] + (1.0 - share) * examples[ends[1]]
    rng = np.random.default_rng(seed)
    for begin in range(0, count, PART):
        chosen = rng.integers(0, foods, min(PART, count - begin))
        apart = rng.integers(0, len(one), len(chosen))
        embedded = middles[chosen] + WITHIN * (examples[one[apart]] - examples[other[apart]])
        vectors = (metric.centre + metric.sd * (embedded @ back)).astype("<f2")
        yield from zip(chosen.tolist(), vectors, strict=True)


def learn(database: Database, count: int, foods: int) -> None:
    """Give so many records of the largest study a vector and an entry, without runs, which nobody asks for."""
    record = EffectiveRecord
    with database.read() as session:
        items = session.execute(
            sa.select(record.item_id, record.study_id, record.participant_id, record.captured_at)
            .where(record.study_id == largest_study(session))
            .limit(count)
        ).all()
    run = {"run_id": uuid.UUID(int=1), "vcm_version": VCM_VERSION}
    made = zip(items, regions(count, foods, seed=1), strict=True)
    with sa.create_engine(database.write_engine.url).connect() as connection:
        is_sqlite = database.is_sqlite
        unchecked = (
            "PRAGMA foreign_keys = OFF" if is_sqlite else "SET session_replication_role = replica"
        )
        connection.exec_driver_sql(unchecked)
        for _ in range(0, count, PART):
            part = [next(made) for _ in range(min(PART, count))]
            seen = [
                {"item_id": item.item_id, "vector": vector.tobytes(), "created_at": NOW} | run
                for item, (_, vector) in part
            ]
            entries = [
                dict(item._mapping)  # noqa: SLF001  # SQLAlchemy's public name
                | {"food_key": f"food {food}", "volume_ml": 150.0, "day_minute": 720}
                | run
                for item, (food, _) in part
            ]
            connection.execute(sa.insert(ItemIdentification), seen)
            connection.execute(sa.insert(IndexEntry), entries)
        connection.commit()
    with database.write_engine.connect().execution_options(isolation_level="AUTOCOMMIT") as free:
        free.exec_driver_sql("ANALYZE")


def largest_study(session: sa.orm.Session) -> uuid.UUID:
    query = sa.select(EffectiveRecord.study_id).group_by(EffectiveRecord.study_id)
    return session.scalars(query.order_by(sa.func.count().desc()).limit(1)).one()


def measure(url: str, foods: int) -> None:
    database = Database(url)
    with database.read() as session:
        study_id = largest_study(session)
        eaten = session.scalars(sa.select(Meal).where(Meal.study_id == study_id).limit(1)).one()
    meal = Meal(
        id=uuid.uuid4(), study_id=study_id, participant_id=eaten.participant_id
    )  # a new one
    shipped_index()
    before = memory_mb()
    learned = LearnedIndex(database, shipped_index)

    def ready() -> None:
        with learned.identifier_for(meal):
            pass

    print(f"first read                  {seconds(ready):>8.1f} s")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"memory before, peak, after  {before:>8.0f}, {peak:.0f}, {memory_mb():.0f} MB")
    print(f"nothing changed             {1e3 * median(ready):>8.1f} ms")

    def change(statement: Callable[[IndexEntry, int], Sequence[sa.Executable]]) -> float:
        times = []
        for _ in range(7):
            with database.write() as session:
                study = session.get_one(Study, study_id)
                study.change_seq += 1
                entry = session.scalars(
                    sa.select(IndexEntry).where(IndexEntry.study_id == study_id).limit(1)
                ).one()
                for one in statement(entry, study.change_seq):
                    session.execute(one)
            times.append(seconds(ready))
        return 1e3 * float(np.median(times))

    named = change(lambda entry, seq: (
        sa.update(IndexEntry).where(IndexEntry.item_id == entry.item_id).values(food_key=f"food {seq % 9}"),
        sa.update(EffectiveRecord).where(EffectiveRecord.item_id == entry.item_id).values(change_seq=seq),
    ))  # fmt: skip
    print(f"one food named anew         {named:>8.1f} ms")
    erased = change(lambda entry, seq: (
        sa.delete(IndexEntry).where(IndexEntry.item_id == entry.item_id),
        sa.insert(Tombstone).values(
            kind="record", digest=public_digest(entry.item_id), study_id=study_id, change_seq=seq, erased_at=NOW),
    ))  # fmt: skip
    print(f"one item erased             {erased:>8.1f} ms")
    with learned.identifier_for(meal) as identifier:
        print_identification(identifier, foods, str(meal.participant_id))


def print_identification(identifier: Identifier, foods: int, eater: str) -> None:
    circumstances = Circumstances(150.0, 0.2, 720, eater=eater)
    times, right, near = [], 0, []
    examples = identifier._own  # noqa: SLF001
    vectors = examples._vectors[: len(examples)].astype(np.float32)  # noqa: SLF001
    squares = (vectors**2).sum(axis=1)
    for food, vector in regions(ASKED, foods, seed=2):
        given = vector.astype(np.float64)
        started = time.process_time()
        found = identifier.identify(given, circumstances)
        times.append(time.process_time() - started)
        right += found.candidates[0].food_key == f"food {food}"
        (view,) = shipped_index().metric.embed(given[None])
        apart = squares - 2.0 * (vectors @ view.astype(np.float32))
        told, _ = examples.near(view)
        nearest = vectors[np.argpartition(apart, NEAREST)[:NEAREST]]
        farthest = ((nearest - view) ** 2).sum(axis=1).max()
        found_near = np.count_nonzero(((told - view) ** 2).sum(axis=1) <= farthest + 1e-6)
        near.append(min(found_near / NEAREST, 1.0))
    spread = f"slowest {1e3 * max(times):.1f}"
    print(f"one region                  {1e3 * float(np.median(times)):>8.1f} ms, {spread}")
    print(f"first candidate right       {right / ASKED:>8.0%} of {ASKED}")
    print(f"nearest that are preselected{np.mean(near):>8.1%}")


def seconds(call: Callable[[], None]) -> float:
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def median(call: Callable[[], None]) -> float:
    return float(np.median([seconds(call) for _ in range(9)]))


def memory_mb() -> float:
    """Resident memory of this process now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


if __name__ == "__main__":
    raise SystemExit(main())
