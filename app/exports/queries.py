"""SQL of exports in the background: requests, unfinished exports, files to delete."""

import uuid
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Literal, NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.exports.file_work_queries import WorkKey, begin_again, find_work, page_of_works
from app.exports.models import UNDER_WAY, Export
from app.http.file_formats import OF_PLACES
from app.http.row_filter import RowFilter
from app.meals.stored.models import Meal, MealImage
from app.people import privacy_queries as privacy
from app.people.models import Participant, Study
from app.people.privacy_models import ErasureReceipt
from app.records.page_queries import RecordSearch

ENDED = ("failed", "cancelled", "expired")


class RequestedExport(NamedTuple):
    """An export, and the name of the staff member who requested it."""

    export: Export
    requested_by: str


class Moment(NamedTuple):
    """A state of a study: its change counter, and its number of erasures of rows."""

    change_seq: int
    erasures: int


def page_of_exports(
    session: Session, study_id: uuid.UUID, *, after: WorkKey | None, limit: int
) -> list[RequestedExport]:
    """Return at most `limit` exports of a study after `after`, the newest first."""
    return [
        RequestedExport(*row)
        for row in page_of_works(session, Export, study_id, after=after, limit=limit)
    ]


def find_export(
    session: Session, study_id: uuid.UUID, export_id: uuid.UUID, *, lock: bool = False
) -> RequestedExport | None:
    """Return an export of this study."""
    row = find_work(session, Export, study_id, Export.id == export_id, lock=lock)
    return RequestedExport(*row) if row is not None else None


def same_under_way(
    session: Session, study_id: uuid.UUID, staff_id: uuid.UUID, spec_sha256: str
) -> Export | None:
    """Return this person's unfinished export with the same spec."""
    return session.scalars(
        sa.select(Export).where(
            Export.study_id == study_id,
            Export.staff_id == staff_id,
            Export.spec_sha256 == spec_sha256,
            Export.state.in_(UNDER_WAY),
        )
    ).one_or_none()


def count_under_way(session: Session, study_id: uuid.UUID, staff_id: uuid.UUID) -> tuple[int, int]:
    """Count (this person's, all) unfinished exports of a study."""
    query = sa.select(
        sa.func.count(sa.case((Export.staff_id == staff_id, Export.id))), sa.func.count(Export.id)
    ).where(Export.study_id == study_id, Export.state.in_(UNDER_WAY))
    own, all_of_study = session.execute(query).one()
    return own, all_of_study


def count_records(session: Session, search: RecordSearch | None, most: int | None) -> int:
    """Count the records of a search, up to `most`."""
    if search is None:
        return 0
    page = search.page(None, most)
    return session.scalar(sa.select(sa.func.count()).select_from(page)) or 0


def count_rows(
    session: Session,
    study_id: uuid.UUID,
    rows: Literal["meals", "days", "photographs"],
    chosen: RowFilter,
    most: int | None = None,
) -> int:
    """Count meals, photographs or days with a meal, by participant and local days, up to `most`."""
    query = sa.select(Meal.participant_id, Meal.local_date).where(Meal.study_id == study_id)
    if rows == "photographs":
        query = query.join(MealImage, MealImage.meal_id == Meal.id)
    if chosen.participant_code is not None:
        query = query.join(Participant, Participant.id == Meal.participant_id)
        query = query.where(Participant.code == chosen.participant_code)
    if chosen.first_day is not None:
        query = query.where(Meal.local_date >= chosen.first_day)
    if chosen.last_day is not None:
        query = query.where(Meal.local_date <= chosen.last_day)
    if rows == "days":
        query = query.distinct()
    return session.scalar(sa.select(sa.func.count()).select_from(query.limit(most).subquery())) or 0


def lock_study(session: Session, study_id: uuid.UUID, *, shared: bool = False) -> None:
    """Lock the study until this transaction ends, also against changes of its change counter. shared: among readers."""
    query = sa.select(Study.id).where(Study.id == study_id)
    session.execute(
        query.with_for_update(read=True) if shared else query.with_for_update(key_share=True)
    )


def moment_of(session: Session, study_id: uuid.UUID) -> Moment:
    """Return the study's state in this transaction.

    Erasures are counted by their receipts, without those of photographs only and those under the policy "keep", which
    remove no rows.
    """
    receipts = sa.select(sa.func.count()).where(
        ErasureReceipt.study_id == study_id,
        ErasureReceipt.what != "photographs",
        ErasureReceipt.policy != "keep",
    )
    change_seq = sa.select(Study.change_seq).where(Study.id == study_id)
    row = session.execute(sa.select(change_seq.scalar_subquery(), receipts.scalar_subquery())).one()
    return Moment(*row)


def erasures_since(session: Session, study_id: uuid.UUID, moment: Moment) -> int:
    """Count the erasures of the study's rows since that moment."""
    return moment_of(session, study_id).erasures - moment.erasures


def expire(session: Session, exports: Iterable[Export], now: datetime) -> int:
    """Expire these exports and mark their files for deletion. Returns the number of exports."""
    count = 0
    for export in exports:
        if export.blob_key is not None:
            privacy.schedule_deletion(session, [export.blob_key], now)
        export.state, export.blob_key, export.sha256 = "expired", None, None
        export.finished_at = export.finished_at or now
        count += 1
    session.flush()
    return count


def expire_due(session: Session, now: datetime, limit: int) -> int:
    """Expire at most `limit` exports whose time is over. Returns the number."""
    query = (
        sa.select(Export)
        .where(Export.state == "done", Export.expires_at <= now)
        .order_by(Export.id)
        .limit(limit)
        .with_for_update(skip_locked=True)
    )
    return expire(session, session.scalars(query).all(), now)


def forget_ended(session: Session, before: datetime) -> int:
    """Delete the rows of exports without a file that ended before then. Returns the number."""
    deleted = session.execute(
        sa.delete(Export)
        .where(Export.state.in_(ENDED), Export.finished_at < before)
        .returning(Export.id)
        .execution_options(synchronize_session=False)
    )
    return len(deleted.all())


def erase_from_exports(session: Session, study_id: uuid.UUID, participant_code: str | None) -> int:
    """At the end of an erasure's transaction, expire all files of the study, which may hold the erased data.

    participant_code: of a person whose code is erased too; exports whose filter names it are deleted. Returns the
    number of exports that lost their file.
    """
    exports = _locked_exports(session, study_id)
    lost = _take_back(session, exports)
    for export in exports:
        if (
            participant_code is not None
            and export.spec["filters"].get("participant_code") == participant_code
        ):
            session.delete(export)
    session.flush()
    return lost


def take_back_places(session: Session, study_id: uuid.UUID) -> int:
    """When a study stops keeping places, expire all files that may hold any. Returns the number."""
    exports = _locked_exports(session, study_id)
    return _take_back(
        session,
        [
            export
            for export in exports
            if export.spec["rows"] == "meals" or export.spec["output"] in OF_PLACES
        ],
    )


def _locked_exports(session: Session, study_id: uuid.UUID) -> list[Export]:
    """Return all exports of a study, locked.

    The study is locked first: a process that is finishing a file has either committed, and its export is seen here, or
    it sees the erasure (releases/file_runner.py).
    """
    lock_study(session, study_id)
    query = (
        sa.select(Export).where(Export.study_id == study_id).order_by(Export.id).with_for_update()
    )
    return list(session.scalars(query.execution_options(populate_existing=True)))


def _take_back(session: Session, exports: Iterable[Export]) -> int:
    """Expire finished exports and restart unfinished ones. Returns the number of expired files."""
    now, lost = datetime.now(UTC), 0
    for export in exports:
        if export.state == "done":
            lost += expire(session, [export], now)
        elif export.state in UNDER_WAY:
            begin_again(export, counts=False)
    session.flush()
    return lost
