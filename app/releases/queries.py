"""SQL of releases: names and files, the foods that frozen items are of, and what erasures want out of them."""

import uuid
from collections.abc import Collection, Iterable, Iterator
from datetime import UTC, date, datetime
from itertools import islice
from typing import Any, Literal, NamedTuple

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
Deed = Literal["meal", "erase", "anonymise"]


class NamedRelease(NamedTuple):
    """A release, who made it, and its files by name."""

    release: Release
    made_by: str
    files: list[ReleaseFile]


class StuckRelease(NamedTuple):
    """A release that could not be written without what was erased, and why."""

    study_code: str
    name: str
    failure_code: str | None


def stuck_releases(session: Session, limit: int) -> list[StuckRelease]:
    """The first of them; each is tried again."""
    query = (
        sa.select(Study.code, Release.name, Release.failure_code)
        .join(Study, Study.id == Release.study_id)
        .where(Release.state == "changing", Release.failure_code.is_not(None))
        .order_by(Study.code, Release.name)
        .limit(limit)
    )
    return [StuckRelease(*row) for row in session.execute(query)]


def page_of_releases(session: Session, study_id: uuid.UUID, *, after: WorkKey | None, limit: int) -> list[NamedRelease]:
    """At most `limit` releases of a study, the newest first, those behind `after`."""
    page = page_of_works(session, Release, study_id, after=after, limit=limit)
    files = _files_by_release(session, [release.id for release, _ in page])
    return [NamedRelease(release, made_by, files.get(release.id, [])) for release, made_by in page]


def find_release(session: Session, study_id: uuid.UUID, name: str, *, lock: bool = False) -> NamedRelease | None:
    """A release of this study by name."""
    found = find_work(session, Release, study_id, Release.name == name, lock=lock)
    return NamedRelease(*found, files_of(session, found[0].id)) if found is not None else None


def files_of(session: Session, release_id: uuid.UUID) -> list[ReleaseFile]:
    """A release's files by name."""
    return _files_by_release(session, [release_id]).get(release_id, [])


def _files_by_release(session: Session, ids: Collection[uuid.UUID]) -> dict[uuid.UUID, list[ReleaseFile]]:
    """Their files by name; without those that have none."""
    files: dict[uuid.UUID, list[ReleaseFile]] = {}
    query = sa.select(ReleaseFile).order_by(ReleaseFile.release_id, ReleaseFile.name)
    for some in _some(ids):
        for file in session.scalars(query.where(ReleaseFile.release_id.in_(some))):
            files.setdefault(file.release_id, []).append(file)
    return files


def blob_keys(session: Session) -> list[str]:
    """The keys of all files of releases: some fifteen a release."""
    return list(session.scalars(sa.select(ReleaseFile.blob_key).order_by(ReleaseFile.blob_key)))


def replace_files(session: Session, release_id: uuid.UUID, files: Iterable[ReleaseFile]) -> list[str]:
    """The release has these files now; the keys of the blobs of those that it had."""
    old = list(
        session.scalars(
            sa.delete(ReleaseFile).where(ReleaseFile.release_id == release_id).returning(ReleaseFile.blob_key)
        )
    )
    session.add_all(files)
    session.flush()
    return old


def changes_of(session: Session, release_id: uuid.UUID) -> list[ReleaseChange]:
    """What is to be taken out of a release, in the order in which it was erased."""
    query = sa.select(ReleaseChange).where(ReleaseChange.release_id == release_id)
    return list(session.scalars(query.order_by(ReleaseChange.requested_at, ReleaseChange.id)))


def forget_changes(session: Session, ids: Collection[uuid.UUID]) -> None:
    """These are done."""
    session.execute(sa.delete(ReleaseChange).where(ReleaseChange.id.in_(ids)))


def erase_from_releases(
    session: Session, study_id: uuid.UUID, deed: Deed, digest: str, renamed: tuple[str, uuid.UUID] | None = None
) -> int:
    """In an erasure's transaction, at its end: no release of the study is served until it is without what is erased.

    renamed: the code of who stays without their name, and by what the ids of their meals are drawn. A release in the
    making begins again. Returns how many are to change. As with exports the study is locked first.
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
    """In the transaction in which a study begins to drop places: releases in the making begin again, without them."""
    lock_study(session, study_id)
    query = sa.select(Release).where(Release.study_id == study_id, Release.state == "running").order_by(Release.id)
    for release in session.scalars(query.with_for_update().execution_options(populate_existing=True)).all():
        begin_again(release, counts=False)
    session.flush()


def eaten_on_days(
    session: Session, study_id: uuid.UUID, participant_codes: Collection[str], first_day: date, last_day: date
) -> sa.Result[*tuple[Any, ...]]:
    """(code, local_date, consumed_g, HEADLINE_COLUMNS) of these participants' records that hold."""
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
) -> sa.Result[*tuple[Any, ...]]:
    """(code, local_date, captured_at, received_at) of these participants' meals."""
    query = sa.select(Participant.code, Meal.local_date, Meal.captured_at, Meal.received_at)
    return session.execute(
        query.join(Participant, Participant.id == Meal.participant_id).where(
            Participant.study_id == study_id,
            Participant.code.in_(participant_codes),
            Meal.local_date.between(first_day, last_day),
        )
    )


def drop_files(session: Session, release: Release, now: datetime) -> None:
    """A release that can never be served again keeps nothing: what was erased may stand in any file of it."""
    privacy.want_deleted(session, replace_files(session, release.id, []), now)
    forget_changes(session, [change.id for change in changes_of(session, release.id)])
    release.bytes = release.rows_written = 0


def foods_used(session: Session, used: Collection[UsedFood]) -> dict[int, UsedFood]:
    """The ids of these foods, in the order of (key, table, version)."""
    found: dict[int, UsedFood] = {}
    for keys in _some({key for key, _, _ in used}):
        table = FoodRelease.name + " " + FoodRelease.version
        query = (
            sa.select(Food.id, Food.key, Food.version, table)
            .join(FoodRelease, FoodRelease.id == Food.release_id)
            .where(Food.key.in_(keys))
        )
        found |= {
            food_id: (key, version, name)
            for food_id, key, version, name in session.execute(query)
            if (key, version, name) in used
        }
    return dict(sorted(found.items(), key=lambda one: (one[1][0], one[1][2], one[1][1] or 0)))


def foods_by_id(session: Session, ids: Collection[int]) -> dict[int, Food]:
    """Foods."""
    return {food.id: food for some in _some(ids) for food in session.scalars(sa.select(Food).where(Food.id.in_(some)))}


def nutrients_by_food(session: Session, ids: Collection[int]) -> Iterator[tuple[int, list[tuple[Any, ...]]]]:
    """(food, [(number, tagname, name, unit, per 100 g) in the components' order]), a few foods at a time."""
    for some in _some(ids):
        found: dict[int, list[tuple[Any, ...]]] = {food_id: [] for food_id in some}
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
            .where(FoodNutrient.food_id.in_(some))
            .order_by(Component.number)
        )
        for food_id, *values in session.execute(query):
            found[food_id].append(tuple(values))
        yield from found.items()


def densities_by_food(session: Session, ids: Collection[int]) -> dict[int, list[FoodDensity]]:
    """The tables' densities of these foods, in the tables' order."""
    found: dict[int, list[FoodDensity]] = {food_id: [] for food_id in ids}
    for some in _some(ids):
        query = sa.select(FoodDensity).where(FoodDensity.food_id.in_(some))
        for density in session.scalars(query.order_by(FoodDensity.food_id, FoodDensity.position)):
            found[density.food_id].append(density)
    return found


def study_densities(session: Session, study_id: uuid.UUID, keys: Collection[str]) -> list[StudyDensity]:
    """The study's own measurements of these foods that hold."""
    query = sa.select(StudyDensity).where(StudyDensity.study_id == study_id, StudyDensity.withdrawn_at.is_(None))
    found = session.scalars(query.order_by(StudyDensity.food_key, StudyDensity.measured_at, StudyDensity.id))
    return [one for one in found if one.food_key in keys]


def _some(values: Collection[Any]) -> Iterator[list[Any]]:
    left = iter(values if isinstance(values, dict | list) else sorted(values))
    while some := list(islice(left, KEYS_A_STATEMENT)):
        yield some
