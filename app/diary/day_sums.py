"""The kept sums of days (DaySum of participants, StudyDaySum of studies): written where a day has changed, and checked.

A change of a meal, a record or a word leaves a mark in its own transaction (triggers), and the writing of a
participant's day one of the study's. Whoever reads counts marked days itself, so that what is told is right at any
moment; here the marks are worked off in the background, so that there are few to count.
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
from app.diary.day_sum_queries import Columns, DayOf, Pair

ROUND_SECONDS = 2.0  # then the worker's other chores have their turn
COMPARED_AT_A_TIME = 100  # in one transaction
SAME = 1e-9  # relative: the order in which a database adds is its own


@dataclass(frozen=True, slots=True)
class ComparedDays:
    """How many days were compared, and of how many the kept sums were not what they should be."""

    compared: int
    different: int


def write_sums(database: Database, seconds: float = ROUND_SECONDS, marks_a_turn: int = day_sums.OF_ONE_TURN) -> int:
    """Write the sums of marked days for at most so many seconds. Returns how many marks are gone.

    marks_a_turn: in one transaction, for which SQLite's other writers wait. Where several workers call it at once, one
    writes and the others return 0.
    """
    with database.read() as session:
        if not day_sums.has_marks(session):
            return 0
    return _take_turns(database, lambda session: _one_turn(session, marks_a_turn), seconds)


def write_study_sums(database: Database, seconds: float = ROUND_SECONDS) -> int:
    """Write the sums of marked days of studies, a day in one transaction, for so many seconds. Returns how many."""
    with database.read() as session:  # most often there is nothing, and nobody waits for it
        if study_day_sums.next_marked(session) is None:
            return 0
    return _take_turns(database, _one_study_day, seconds)


def write_all_sums(database: Database, marks_a_turn: int = day_sums.OF_ONE_TURN) -> int:
    """Work off all marks, as long as there are any that this process may write. Returns how many of participants."""
    done = write_sums(database, math.inf, marks_a_turn)
    write_study_sums(database, math.inf)
    return done


def compare_days(database: Database, *, write: bool) -> ComparedDays:
    """Compare the kept sums of every day that is not marked with what it comes to; with `write`, put right all."""
    return _compare(
        database, day_sums.days_after, day_sums.kept_and_counted, day_sums.mark_days, write_all_sums if write else None
    )


def compare_study_days(database: Database, *, write: bool) -> ComparedDays:
    """Compare the kept sums of every study's day that is not marked with what it comes to; with `write`, put right all.

    Participants' days are taken as they are kept: see `compare_days`.
    """
    return _compare(
        database,
        study_day_sums.days_after,
        study_day_sums.kept_and_counted,
        study_day_sums.mark_days,
        (lambda database: write_study_sums(database, math.inf)) if write else None,
    )


def _compare(
    database: Database,
    days_after: Callable[[Session, DayOf | None, int], list[DayOf]],
    kept_and_counted: Callable[[Session, Sequence[DayOf]], Sequence[Pair]],
    mark_days: Callable[[Session, Sequence[DayOf]], None],
    write_sums: Callable[[Database], int] | None,
) -> ComparedDays:
    """Compare day by day, and mark those that differ where there is a writer."""
    if write_sums is not None:
        write_sums(database)
    compared = different = 0
    after = None
    while True:
        with database.read() as session:
            days = days_after(session, after, COMPARED_AT_A_TIME)
            if not days:
                break
            pairs = kept_and_counted(session, days)
        wrong = [day for day, kept, counted in pairs if not _is_same(kept, counted)]
        compared += len(pairs)
        different += len(wrong)
        after = days[-1]
        if write_sums is not None and wrong:
            with database.write() as session:
                mark_days(session, wrong)
    if write_sums is not None and different:
        write_sums(database)
    return ComparedDays(compared, different)


def _take_turns(database: Database, turn: Callable[[Session], int], seconds: float) -> int:
    """Let `turn` write, each time in a transaction, until it returns 0 or the time is over. Returns the sum."""
    done, until = 0, time.monotonic() + seconds
    while True:
        with database.write() as session:
            count = turn(session)
        done += count
        if count == 0 or time.monotonic() > until:
            return done


def _one_study_day(session: Session) -> int:
    marked = study_day_sums.next_marked(session) if day_sums.take_turn(session) else None
    if marked is None:
        return 0
    study_day_sums.write_day(session, marked)
    return 1


def _one_turn(session: Session, limit: int) -> int:
    """Write the sums of some marked days, in this transaction. Returns how many marks are gone."""
    if not day_sums.take_turn(session):
        return 0
    marks = day_sums.newest_marks(session, limit)
    if not marks:
        return 0
    there, staying = day_sums.people_among(session, {mark.participant_id for mark in marks})
    gone = [mark.id for mark in marks if mark.participant_id not in there]
    due = [mark for mark in marks if mark.participant_id in staying]
    if gone:  # erased since
        day_sums.forget_marks(session, gone)
    if due:
        day_sums.write_sums(session, due)
    return len(gone) + len(due)


def _is_same(kept: Columns | None, counted: Columns | None) -> bool:
    if kept is None or counted is None:
        return kept is counted
    return all(_is_near(kept[name], counted[name]) for name in counted)


def _is_near(value: object, other: object) -> bool:
    if isinstance(value, float) and isinstance(other, float):
        return math.isclose(value, other, rel_tol=SAME, abs_tol=SAME)
    if isinstance(value, SortedValues) and isinstance(other, SortedValues):
        return len(value) == len(other) and all(map(_is_near, value.values, other.values))
    return value == other
