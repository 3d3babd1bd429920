"""SQL of releases: names and files, the foods of frozen items, pending removals of erased data."""

import uuid
from collections.abc import Collection, Iterable, Iterator
from datetime import UTC, date, datetime
from itertools import islice
from typing import Literal, NamedTuple, TypeVar

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.exports.file_work_queries import WorkKey, begin_again, find_work, page_of_works
from app.exports.queries import lock_study
from app.exports.release_models import Release, ReleaseChange, ReleaseFile
from app.foods.models import Component, Food, FoodDensity, FoodNutrient, FoodRelease, StudyDensity
from app.meals.models import Meal
from app.meals.record_models import HEADLINE_COLUMNS, EffectiveRecord
from app.people import privacy_queries as privacy
from app.people.models import Participant, Study

KEYS_A_STATEMENT = 500
UsedFood = tuple[str, int | None, str]  # key, version, table
FoodNutrientRow = tuple[str, str | None, str, str, float]  # number, tagname, name, unit, per 100 g
T = TypeVar("T")
Deed = Literal["meal", "erase", "anonymise"]


class ReleaseRow(NamedTuple):
    """A release, the name of the staff member who requested it, and its files by name."""

    release: Release
    requested_by: str
    files: list[ReleaseFile]


class StuckRelease(NamedTuple):
    """A release that could not be rewritten without erased data, and why."""

    study_code: str
    name: str
    failure_code: str | None


def stuck_releases(session: Session, limit: int) -> list[StuckRelease]:
    """Return the first `limit` of them; each is tried again."""
    query = (
        sa.select(Study.code, Release.name, Release.failure_code)
        .join(Study, Study.id == Release.study_id)
        .where(Release.state == "changing", Release.failure_code.is_not(None))
        .order_by(Study.code, Release.name)
        .limit(limit)
    )
    return [StuckRelease(*row) for row in session.execute(query)]


def page_of_releases(session: Session, study_id: uuid.UUID, *, after: WorkKey | None, limit: int) -> list[ReleaseRow]:
    """Return at most `limit` releases of a study after `after`, the newest first."""
    page = page_of_works(session, Release, study_id, after=after, limit=limit)
    files = _files_by_release(session, [release.id for release, _ in page])
    return [ReleaseRow(release, requested_by, files.get(release.id, [])) for release, requested_by in page]


def find_release(session: Session, study_id: uuid.UUID, name: str, *, lock: bool = False) -> ReleaseRow | None:
    """Return a release of this study."""
    row = find_work(session, Release, study_id, Release.name == name, lock=lock)
    return ReleaseRow(*row, files_of(session, row[0].id)) if row is not None else None


def files_of(session: Session, release_id: uuid.UUID) -> list[ReleaseFile]:
    """Return a release's files by name."""
    return _files_by_release(session, [release_id]).get(release_id, [])


def _files_by_release(session: Session, ids: Collection[uuid.UUID]) -> dict[uuid.UUID, list[ReleaseFile]]:
    """Return release id -> files by name, without releases that have no files."""
    files: dict[uuid.UUID, list[ReleaseFile]] = {}
    query = sa.select(ReleaseFile).order_by(ReleaseFile.release_id, ReleaseFile.name)
    for batch in _batches(ids):
        for file in session.scalars(query.where(ReleaseFile.release_id.in_(batch))):
            files.setdefault(file.release_id, []).append(file)
    return files


def blob_keys(session: Session) -> list[str]:
    """Return the keys of all files of releases: about fifteen per release."""
    return list(session.scalars(sa.select(ReleaseFile.blob_key).order_by(ReleaseFile.blob_key)))


def replace_files(session: Session, release_id: uuid.UUID, files: Iterable[ReleaseFile]) -> list[str]:
    """Replace the release's files. Returns the blob keys of the former files."""
    old = list(
        session.scalars(
            sa.delete(ReleaseFile).where(ReleaseFile.release_id == release_id).returning(ReleaseFile.blob_key)
        )
    )
    session.add_all(files)
    session.flush()
    return old


def changes_of(session: Session, release_id: uuid.UUID) -> list[ReleaseChange]:
    """Return a release's pending removals, in the order of the erasures."""
    query = sa.select(ReleaseChange).where(ReleaseChange.release_id == release_id)
    return list(session.scalars(query.order_by(ReleaseChange.requested_at, ReleaseChange.id)))


def forget_changes(session: Session, ids: Collection[uuid.UUID]) -> None:
    """Delete removals that are done."""
    session.execute(sa.delete(ReleaseChange).where(ReleaseChange.id.in_(ids)))


def erase_from_releases(
    session: Session, study_id: uuid.UUID, deed: Deed, digest: str, renamed: tuple[str, uuid.UUID] | None = None
) -> int:
    """At the end of an erasure's transaction, stop serving the study's releases until the erased data are removed.

    renamed: (new code, namespace of the new meal ids) of an anonymised participant. An unfinished release begins again.
    Returns the number of releases to change. The study is locked first, as for exports.
    """
    lock_study(session, study_id)
    query = sa.select(Release).where(Release.study_id == study_id).order_by(Release.id).with_for_update()
    now, changing = datetime.now(UTC), 0
    for release in session.scalars(query.execution_options(populate_existing=True)).all():
        if release.state == "failed":
            continue
        begin_again(release, counts=False)
        if release.state == "queued":
            continue
        release.state = "changing"
        changing += 1
        new_code, new_ids = renamed if renamed is not None else (None, None)
        session.add(
            ReleaseChange(
                id=uuid.uuid4(),
                release_id=release.id,
                deed=deed,
                digest=digest,
                new_code=new_code,
                new_ids=new_ids,
                requested_at=now,
            )
        )
    session.flush()
    return changing


def take_back_places(session: Session, study_id: uuid.UUID) -> None:
    """When a study stops keeping places, restart its unfinished releases, which are then made without places."""
    lock_study(session, study_id)
    query = sa.select(Release).where(Release.study_id == study_id, Release.state == "running").order_by(Release.id)
    for release in session.scalars(query.with_for_update().execution_options(populate_existing=True)).all():
        begin_again(release, counts=False)
    session.flush()


def eaten_on_days(
    session: Session, study_id: uuid.UUID, participant_codes: Collection[str], first_day: date, last_day: date
) -> sa.Result[str, date, *tuple[float | None, ...]]:
    """Return (code, local_date, consumed_g, *HEADLINE_COLUMNS) of these participants' records that count."""
    record = EffectiveRecord
    amounts = (record.consumed_g, *(getattr(record, name) for name in HEADLINE_COLUMNS))
    query = sa.select(Participant.code, record.local_date, *amounts)
    return session.execute(
        query.join(Participant, Participant.id == record.participant_id).where(
            Participant.study_id == study_id,
            Participant.code.in_(participant_codes),
            record.local_date.between(first_day, last_day),
            record.status != "rejected",
        )
    )


def arrivals_on_days(
    session: Session, study_id: uuid.UUID, participant_codes: Collection[str], first_day: date, last_day: date
) -> sa.Result[str, date, datetime, datetime]:
    """Return (code, local_date, captured_at, received_at) of these participants' meals."""
    query = sa.select(Participant.code, Meal.local_date, Meal.captured_at, Meal.received_at)
    return session.execute(
        query.join(Participant, Participant.id == Meal.participant_id).where(
            Participant.study_id == study_id,
            Participant.code.in_(participant_codes),
            Meal.local_date.between(first_day, last_day),
        )
    )


def drop_files(session: Session, release: Release, now: datetime) -> None:
    """Delete all files of a release that can never be served again: any of them may hold erased data."""
    privacy.schedule_deletion(session, replace_files(session, release.id, []), now)
    forget_changes(session, [change.id for change in changes_of(session, release.id)])
    release.bytes = release.rows_written = 0


def foods_used(session: Session, used: Collection[UsedFood]) -> dict[int, UsedFood]:
    """Return food id -> food, in the order of (key, table, version)."""
    foods: dict[int, UsedFood] = {}
    for keys in _batches(sorted({key for key, _, _ in used})):
        table = FoodRelease.name + " " + FoodRelease.version
        query = (
            sa.select(Food.id, Food.key, Food.version, table)
            .join(FoodRelease, FoodRelease.id == Food.release_id)
            .where(Food.key.in_(keys))
        )
        foods |= {
            food_id: (key, version, name)
            for food_id, key, version, name in session.execute(query)
            if (key, version, name) in used
        }
    return dict(sorted(foods.items(), key=lambda pair: (pair[1][0], pair[1][2], pair[1][1] or 0)))


def foods_by_id(session: Session, ids: Collection[int]) -> dict[int, Food]:
    """Return food id -> food."""
    query = sa.select(Food)
    return {food.id: food for batch in _batches(ids) for food in session.scalars(query.where(Food.id.in_(batch)))}


def nutrients_by_food(session: Session, ids: Collection[int]) -> Iterator[tuple[int, list[FoodNutrientRow]]]:
    """Yield (food id, nutrients in the components' order), reading some foods at a time."""
    for batch in _batches(ids):
        nutrients: dict[int, list[FoodNutrientRow]] = {food_id: [] for food_id in batch}
        query = (
            sa.select(
                FoodNutrient.food_id,
                Component.number,
                Component.tagname,
                Component.name,
                Component.unit,
                FoodNutrient.per_100_g,
            )
            .join(Component, Component.id == FoodNutrient.component_id)
            .where(FoodNutrient.food_id.in_(batch))
            .order_by(Component.number)
        )
        for food_id, number, tagname, name, unit, per_100_g in session.execute(query):
            nutrients[food_id].append((number, tagname, name, unit, per_100_g))
        yield from nutrients.items()


def densities_by_food(session: Session, ids: Collection[int]) -> dict[int, list[FoodDensity]]:
    """Return food id -> densities of the food table, in its order."""
    densities: dict[int, list[FoodDensity]] = {food_id: [] for food_id in ids}
    for batch in _batches(ids):
        query = sa.select(FoodDensity).where(FoodDensity.food_id.in_(batch))
        for density in session.scalars(query.order_by(FoodDensity.food_id, FoodDensity.position)):
            densities[density.food_id].append(density)
    return densities


def study_densities(session: Session, study_id: uuid.UUID, keys: Collection[str]) -> list[StudyDensity]:
    """Return the study's own densities of these foods that were not withdrawn."""
    query = sa.select(StudyDensity).where(StudyDensity.study_id == study_id, StudyDensity.withdrawn_at.is_(None))
    densities = session.scalars(query.order_by(StudyDensity.food_key, StudyDensity.measured_at, StudyDensity.id))
    return [density for density in densities if density.food_key in keys]


def _batches(values: Iterable[T]) -> Iterator[list[T]]:
    rest = iter(values)
    while batch := list(islice(rest, KEYS_A_STATEMENT)):
        yield batch
