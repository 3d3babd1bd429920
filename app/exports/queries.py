"""SQL of exports in the background: who asked for what, what is under way, and which files are to go."""

import uuid
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Literal, NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.exports.file_work_queries import WorkKey, begin_again, find_work, page_of_works
from app.exports.models import UNDER_WAY, Export
from app.http.row_filter import RowFilter
from app.meals.models import Meal, MealImage
from app.people import privacy_queries as privacy
from app.people.models import Participant, Study
from app.people.privacy_models import ErasureReceipt
from app.records.page_queries import RecordSearch

ENDED = ("failed", "cancelled", "expired")


class AskedExport(NamedTuple):
    """An export, and the name of who asked for it."""

    export: Export
    asked_by: str


class Moment(NamedTuple):
    """Where a study stands: its counter of changes, and how many erasures of its rows there were."""

    change_seq: int
    erasures: int


def page_of_exports(session: Session, study_id: uuid.UUID, *, after: WorkKey | None, limit: int) -> list[AskedExport]:
    """At most `limit` exports of a study, the newest first, those behind `after`."""
    return [AskedExport(*row) for row in page_of_works(session, Export, study_id, after=after, limit=limit)]


def find_export(
    session: Session, study_id: uuid.UUID, export_id: uuid.UUID, *, lock: bool = False
) -> AskedExport | None:
    """An export of this study."""
    found = find_work(session, Export, study_id, Export.id == export_id, lock=lock)
    return AskedExport(*found) if found is not None else None


def same_under_way(session: Session, study_id: uuid.UUID, staff_id: uuid.UUID, spec_sha256: str) -> Export | None:
    """What this person has asked for in the same words, and waits for."""
    return session.scalars(
        sa.select(Export).where(
            Export.study_id == study_id,
            Export.staff_id == staff_id,
            Export.spec_sha256 == spec_sha256,
            Export.state.in_(UNDER_WAY),
        )
    ).one_or_none()


def under_way(session: Session, study_id: uuid.UUID, staff_id: uuid.UUID) -> tuple[int, int]:
    """(of this person, of all) exports of a study that are not made yet."""
    query = sa.select(sa.func.count(sa.case((Export.staff_id == staff_id, Export.id))), sa.func.count(Export.id)).where(
        Export.study_id == study_id, Export.state.in_(UNDER_WAY)
    )
    mine, every = session.execute(query).one()
    return mine, every


def count_records(session: Session, search: RecordSearch | None, most: int | None = None) -> int:
    """Return how many records a search finds, counted up to `most`."""
    if search is None:
        return 0
    rows = search.rows().subquery() if most is None else search.page(None, most)
    return session.scalar(sa.select(sa.func.count()).select_from(rows)) or 0


def count_rows(
    session: Session,
    study_id: uuid.UUID,
    rows: Literal["meals", "days", "photographs"],
    chosen: RowFilter,
    most: int | None = None,
) -> int:
    """Return how many meals, photographs or days with a meal there are, of a participant, within local days."""
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
    """Until this transaction ends nobody else locks the study so, nor counts a change of it.

    shared: others may do the same.
    """
    query = sa.select(Study.id).where(Study.id == study_id)
    session.execute(query.with_for_update(read=True) if shared else query.with_for_update(key_share=True))


def moment_of(session: Session, study_id: uuid.UUID) -> Moment:
    """Where the study stands for this transaction.

    Erasures are counted by their receipts. Of photographs alone no row goes; who leaves and is kept, stays.
    """
    receipts = sa.select(sa.func.count()).where(
        ErasureReceipt.study_id == study_id, ErasureReceipt.what != "photographs", ErasureReceipt.policy != "keep"
    )
    change_seq = sa.select(Study.change_seq).where(Study.id == study_id)
    row = session.execute(sa.select(change_seq.scalar_subquery(), receipts.scalar_subquery())).one()
    return Moment(*row)


def erasures_since(session: Session, study_id: uuid.UUID, moment: Moment) -> int:
    """Return how many erasures of rows of the study there were since that moment."""
    return moment_of(session, study_id).erasures - moment.erasures


def expire(session: Session, exports: Iterable[Export], now: datetime) -> int:
    """Their files are to go; how many there were."""
    count = 0
    for export in exports:
        if export.blob_key is not None:
            privacy.want_deleted(session, [export.blob_key], now)
        export.state, export.blob_key, export.sha256 = "expired", None, None
        export.finished_at = export.finished_at or now
        count += 1
    session.flush()
    return count


def expire_due(session: Session, now: datetime, limit: int) -> int:
    """Files whose time is over; how many."""
    query = (
        sa.select(Export)
        .where(Export.state == "done", Export.expires_at <= now)
        .order_by(Export.id)
        .limit(limit)
        .with_for_update(skip_locked=True)
    )
    return expire(session, session.scalars(query).all(), now)


def forget_ended(session: Session, before: datetime) -> int:
    """Remove the rows of exports without a file that ended before then; how many."""
    done = session.execute(
        sa.delete(Export)
        .where(Export.state.in_(ENDED), Export.finished_at < before)
        .returning(Export.id)
        .execution_options(synchronize_session=False)
    )
    return len(done.all())


def erase_from_exports(session: Session, study_id: uuid.UUID, participant_code: str | None) -> int:
    """In an erasure's transaction, at its end: no file of the study that may hold what is erased stays.

    participant_code: of a person whose code goes too; exports that name it go wholly. Returns how many exports lost
    their file.
    """
    every = _locked_exports(session, study_id)
    lost = _take_back(session, every)
    for export in every:
        if participant_code is not None and export.spec["filters"].get("participant_code") == participant_code:
            session.delete(export)
    session.flush()
    return lost


def take_back_places(session: Session, study_id: uuid.UUID) -> int:
    """In the transaction in which a study begins to drop places: no file that may hold any stays. Returns how many."""
    every = _locked_exports(session, study_id)
    return _take_back(session, [one for one in every if one.spec["rows"] == "meals" or one.spec["output"] == "geojson"])


def _locked_exports(session: Session, study_id: uuid.UUID) -> list[Export]:
    """All of a study.

    The study is locked first: whoever is just finishing a file is done by then, and is seen here, or sees what has
    changed (releases/file_runner.py).
    """
    lock_study(session, study_id)
    query = sa.select(Export).where(Export.study_id == study_id).order_by(Export.id).with_for_update()
    return list(session.scalars(query.execution_options(populate_existing=True)))


def _take_back(session: Session, exports: Iterable[Export]) -> int:
    """What is done expires; what is being made begins again. Returns how many files there were."""
    now, lost = datetime.now(UTC), 0
    for export in exports:
        if export.state == "done":
            lost += expire(session, [export], now)
        elif export.state in UNDER_WAY:
            begin_again(export, counts=False)
    session.flush()
    return lost
