"""Write and check the stored sums of days: DaySum of participants, StudyDaySum of studies.

A change of a meal, a record or a diary entry marks the participant's day in its own transaction (triggers), and writing
the participant's day marks the study's day. Readers count marked days themselves, so figures are always current; the
background work here keeps the number of marked days small.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.db.session import Database
from app.db.sorted_values import SortedValues
from app.diary import day_sum_queries as day_sums
from app.diary import study_day_sum_queries as study_day_sums
from app.diary.day_sum_queries import Columns, OwnerDay, StoredAndCounted

ROUND_SECONDS = 2.0  # then the worker's other chores run
DAYS_PER_COMPARISON = 100  # in one transaction
RELATIVE_TOLERANCE = 1e-9  # databases add in an order of their own


@dataclass(frozen=True, slots=True)
class ComparedDays:
    """The number of days compared, and of those whose stored sums differ from a recount."""

    compared: int
    different: int


def write_sums(
    database: Database,
    seconds: float = ROUND_SECONDS,
    marks_per_transaction: int = day_sums.MARKS_PER_TRANSACTION,
) -> int:
    """Write the sums of marked days for at most so many seconds. Returns the number of marks removed.

    If several workers call it at once, one writes and the others return 0.
    """
    with database.read() as session:
        if not day_sums.has_marks(session):
            return 0
    return _repeat_in_transactions(
        database, lambda session: _write_marked_days(session, marks_per_transaction), seconds
    )


def write_study_sums(database: Database, seconds: float = ROUND_SECONDS) -> int:
    """Write the sums of studies' marked days, one day per transaction. Returns the number of days written."""
    with database.read() as session:  # usually there is no mark, and no write lock is needed
        if study_day_sums.next_marked(session) is None:
            return 0
    return _repeat_in_transactions(database, _write_marked_study_day, seconds)


def write_all_sums(database: Database, marks_per_transaction: int = day_sums.MARKS_PER_TRANSACTION) -> int:
    """Write the sums of all marked days. Returns the number of marks of participants' days removed."""
    removed = write_sums(database, math.inf, marks_per_transaction)
    write_study_sums(database, math.inf)
    return removed


def compare_days(database: Database, *, write: bool) -> ComparedDays:
    """Compare the stored sums of every unmarked day with a recount. write: correct those that differ."""
    return _compare(
        database,
        day_sums.days_after,
        day_sums.stored_and_counted,
        day_sums.mark_days,
        write_all_sums if write else None,
    )


def compare_study_days(database: Database, *, write: bool) -> ComparedDays:
    """Compare the stored sums of every unmarked study day with a recount. write: correct those that differ.

    The recount uses participants' days as they are stored: see `compare_days`.
    """
    return _compare(
        database,
        study_day_sums.days_after,
        study_day_sums.stored_and_counted,
        study_day_sums.mark_days,
        (lambda database: write_study_sums(database, math.inf)) if write else None,
    )


def _compare(
    database: Database,
    days_after: Callable[[Session, OwnerDay | None, int], list[OwnerDay]],
    stored_and_counted: Callable[[Session, Sequence[OwnerDay]], Sequence[StoredAndCounted]],
    mark_days: Callable[[Session, Sequence[OwnerDay]], None],
    write_sums: Callable[[Database], int] | None,
) -> ComparedDays:
    """Compare all days; with `write_sums`, mark those that differ and write them."""
    if write_sums is not None:
        write_sums(database)
    compared = different = 0
    after = None
    while True:
        with database.read() as session:
            days = days_after(session, after, DAYS_PER_COMPARISON)
            if not days:
                break
            pairs = stored_and_counted(session, days)
        wrong = [day for day, stored, counted in pairs if not _are_equal(stored, counted)]
        compared += len(pairs)
        different += len(wrong)
        after = days[-1]
        if write_sums is not None and wrong:
            with database.write() as session:
                mark_days(session, wrong)
    if write_sums is not None and different:
        write_sums(database)
    return ComparedDays(compared, different)


def _repeat_in_transactions(database: Database, write_some: Callable[[Session], int], seconds: float) -> int:
    """Call `write_some` in one transaction after the other until it returns 0 or time is up. Returns the total."""
    total, until = 0, time.monotonic() + seconds
    while True:
        with database.write() as session:
            count = write_some(session)
        total += count
        if count == 0 or time.monotonic() > until:
            return total


def _write_marked_study_day(session: Session) -> int:
    marked = study_day_sums.next_marked(session) if day_sums.try_lock_writer(session) else None
    if marked is None:
        return 0
    study_day_sums.write_day(session, marked)
    return 1


def _write_marked_days(session: Session, limit: int) -> int:
    """Write the sums of at most `limit` marks in this transaction. Returns the number of marks removed."""
    if not day_sums.try_lock_writer(session):
        return 0
    marks = day_sums.newest_marks(session, limit)
    if not marks:
        return 0
    existing, locked = day_sums.lock_existing_participants(session, {mark.participant_id for mark in marks})
    erased = [mark.id for mark in marks if mark.participant_id not in existing]
    due = [mark for mark in marks if mark.participant_id in locked]
    if erased:
        day_sums.remove_marks(session, erased)
    if due:
        day_sums.write_sums(session, due)
    return len(erased) + len(due)


def _are_equal(stored: Columns | None, counted: Columns | None) -> bool:
    if stored is None or counted is None:
        return stored is counted
    return all(_are_close(stored[name], counted[name]) for name in counted)


def _are_close(value: object, other: object) -> bool:
    if isinstance(value, float) and isinstance(other, float):
        return math.isclose(value, other, rel_tol=RELATIVE_TOLERANCE, abs_tol=RELATIVE_TOLERANCE)
    if isinstance(value, SortedValues) and isinstance(other, SortedValues):
        return len(value) == len(other) and all(map(_are_close, value.values, other.values))
    return value == other
