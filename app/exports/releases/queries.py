"""SQL of releases: names and files, the foods of frozen items, pending removals of erased data."""

import uuid
from collections.abc import Collection, Iterable, Iterator
from datetime import UTC, datetime
from itertools import islice
from typing import Literal, NamedTuple, TypeVar

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.exports.file_work_queries import WorkKey, begin_again, find_work, page_of_works
from app.exports.queries import lock_study
from app.exports.release_models import Release, ReleaseChange, ReleaseFile
from app.people import privacy_queries as privacy
from app.people.models import Study

KEYS_A_STATEMENT = 500
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


def page_of_releases(
    session: Session, study_id: uuid.UUID, *, after: WorkKey | None, limit: int
) -> list[ReleaseRow]:
    """Return at most `limit` releases of a study after `after`, the newest first."""
    page = page_of_works(session, Release, study_id, after=after, limit=limit)
    files = _files_by_release(session, [release.id for release, _ in page])
    return [
        ReleaseRow(release, requested_by, files.get(release.id, []))
        for release, requested_by in page
    ]


def find_release(
    session: Session, study_id: uuid.UUID, name: str, *, lock: bool = False
) -> ReleaseRow | None:
    """Return a release of this study."""
    row = find_work(session, Release, study_id, Release.name == name, lock=lock)
    return ReleaseRow(*row, files_of(session, row[0].id)) if row is not None else None


def files_of(session: Session, release_id: uuid.UUID) -> list[ReleaseFile]:
    """Return a release's files by name."""
    return _files_by_release(session, [release_id]).get(release_id, [])


def _files_by_release(
    session: Session, ids: Collection[uuid.UUID]
) -> dict[uuid.UUID, list[ReleaseFile]]:
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


def replace_files(
    session: Session, release_id: uuid.UUID, files: Iterable[ReleaseFile]
) -> list[str]:
    """Replace the release's files. Returns the blob keys of the former files."""
    old = list(
        session.scalars(
            sa.delete(ReleaseFile)
            .where(ReleaseFile.release_id == release_id)
            .returning(ReleaseFile.blob_key)
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
    session: Session,
    study_id: uuid.UUID,
    deed: Deed,
    digest: str,
    renamed: tuple[str, uuid.UUID] | None = None,
) -> int:
    """At the end of an erasure's transaction, stop serving the study's releases until the erased data are removed.

    renamed: (new code, namespace of the new meal ids) of an anonymised participant. An unfinished release begins again.
    Returns the number of releases to change. The study is locked first, as for exports.
    """
    lock_study(session, study_id)
    query = (
        sa.select(Release)
        .where(Release.study_id == study_id)
        .order_by(Release.id)
        .with_for_update()
    )
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
    query = (
        sa.select(Release)
        .where(Release.study_id == study_id, Release.state == "running")
        .order_by(Release.id)
    )
    for release in session.scalars(
        query.with_for_update().execution_options(populate_existing=True)
    ).all():
        begin_again(release, counts=False)
    session.flush()


def drop_files(session: Session, release: Release, now: datetime) -> None:
    """Delete all files of a release that can never be served again: any of them may hold erased data."""
    privacy.schedule_deletion(session, replace_files(session, release.id, []), now)
    forget_changes(session, [change.id for change in changes_of(session, release.id)])
    release.bytes = release.rows_written = 0


def _batches(values: Iterable[T]) -> Iterator[list[T]]:
    rest = iter(values)
    while batch := list(islice(rest, KEYS_A_STATEMENT)):
        yield batch
