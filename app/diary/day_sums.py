"""The kept sums of days (DaySum of participants, StudyDaySum of studies): written where a day has changed, and checked.

A change of a meal, a record or a word leaves a mark in its own transaction (triggers), and the writing of a
participant's day one of the study's. Whoever reads counts marked days itself, so that what is told is right at any
moment; here the marks are worked off in the background, so that there are few to count.
"""

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy.orm import Session

from app.db.session import Database
from app.diary import day_sum_queries as day_sums
from app.diary import study_day_sum_queries as study_day_sums
from app.diary.study_day_sum_queries import CountedDay

ROUND_SECONDS = 2.0  # then the worker's other chores have their turn
COMPARED_AT_A_TIME = 500
SAME = 1e-9  # relative: the order in which a database adds is its own


@dataclass(frozen=True, slots=True)
class ComparedDays:
    """How many days were compared, and of how many the kept sums were not what they should be."""

    compared: int
    different: int


def write_sums(database: Database, seconds: float = ROUND_SECONDS, marks_a_turn: int = day_sums.OF_ONE_TURN) -> int:
    """Write the sums of marked days, for so long at most. Returns how many marks are worked off.

    marks_a_turn: in one transaction, for which SQLite's other writers wait. Several workers may do it at once: one
    does, the others leave it to them.
    """
    done, until = 0, time.monotonic() + seconds
    with database.read() as session:
        if not day_sums.has_marks(session):
            return 0
    while True:
        with database.write() as session:
            count = _one_turn(session, marks_a_turn)
        done += count
        if count == 0 or time.monotonic() > until:
            return done


def write_study_sums(database: Database, seconds: float = ROUND_SECONDS) -> int:
    """Write the sums of marked days of studies, a day in one transaction, for so long at most. Returns how many."""
    done, until = 0, time.monotonic() + seconds
    with database.read() as session:  # most often there is nothing, and nobody waits for it
        if study_day_sums.next_marked(session) is None:
            return 0
    while True:
        with database.write() as session:
            marked = study_day_sums.next_marked(session) if day_sums.take_turn(session) else None
            if marked is None:
                return done
            study_day_sums.write_day(session, marked)
        done += 1
        if time.monotonic() > until:
            return done


def write_all_sums(database: Database, marks_a_turn: int = day_sums.OF_ONE_TURN) -> int:
    """Work off all marks, as long as there are any that this process may write. Returns how many of participants."""
    done = write_sums(database, math.inf, marks_a_turn)
    write_study_sums(database, math.inf)
    return done


def compare_days(database: Database, *, write: bool) -> ComparedDays:
    """Compare the kept sums of every day that is not marked with what it comes to; with `write`, put right all."""
    if write:
        write_all_sums(database)
    compared = different = 0
    after = None
    while True:
        with database.read() as session:
            days = day_sums.days_after(session, after, COMPARED_AT_A_TIME)
            if not days:
                break
            marked = day_sums.marked_among(session, days)
            kept, counted = day_sums.kept_sums(session, days), day_sums.counted_sums(session, days)
        wrong = [day for day in days if day not in marked and not _is_same(kept.get(day), counted.get(day))]
        compared += len(days) - len(marked.intersection(days))
        different += len(wrong)
        after = days[-1]
        if write and wrong:
            with database.write() as session:
                day_sums.mark_days(session, wrong)
    if write and different:
        write_all_sums(database)
    return ComparedDays(compared, different)


def compare_study_days(database: Database, *, write: bool) -> ComparedDays:
    """Compare the kept sums of every study's day that is not marked with what it comes to; with `write`, put right all.

    What participants' days come to is taken as it is kept: see `compare_days`.
    """
    if write:
        write_study_sums(database, math.inf)
    compared = different = 0
    after = None
    while True:
        with database.read() as session:
            days = study_day_sums.days_after(session, after, COMPARED_AT_A_TIME)
        if not days:
            break
        wrong = []
        for day in days:
            with database.read() as session:
                both = study_day_sums.kept_and_counted(session, day)
            if both is not None:
                compared += 1
                wrong += [] if _is_same_of_study(*both) else [day]
        different += len(wrong)
        after = days[-1]
        if write and wrong:
            with database.write() as session:
                study_day_sums.mark_days(session, wrong)
    if write and different:
        write_study_sums(database, math.inf)
    return ComparedDays(compared, different)


def _is_same_of_study(kept: CountedDay | None, counted: CountedDay | None) -> bool:
    if kept is None or counted is None:
        return kept is counted
    counts, others = asdict(kept.counts), asdict(counted.counts)
    runs = [(kept.delays, counted.delays), *((kept.amounts[name], counted.amounts[name]) for name in counted.amounts)]
    return all(_is_near(counts[name], others[name]) for name in counts) and all(
        len(one) == len(other) and all(map(_is_near, one.values, other.values)) for one, other in runs
    )


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


def _is_same(kept: Mapping[str, Any] | None, counted: Mapping[str, Any] | None) -> bool:
    if kept is None or counted is None:
        return kept is counted
    return all(_is_near(kept[name], counted[name]) for name in counted)


def _is_near(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=SAME, abs_tol=SAME)
    return bool(one == other)
