"""Stored sums of days equal a recount: after any history, with concurrent writers, and before they are written."""

import random
import threading
import uuid
from datetime import UTC, date, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.diary import day_sum_queries as day_sums
from app.diary import intake_queries as intakes
from app.diary import queries as days
from app.diary import study_day_sum_queries as study_day_sums
from app.diary.closed_amounts import StudyWindow, amounts_by_column
from app.diary.day_sums import (
    ComparedDays,
    compare_days,
    compare_study_days,
    write_all_sums,
    write_study_sums,
    write_sums,
)
from app.diary.models import DayMark, DaySum, StudyDayMark, StudyDaySum
from app.http.row_filter import RowFilter
from app.meals.day_models import DiaryDay
from app.meals.models import MEAL_STATUSES, Meal
from app.meals.record_models import HEADLINE_COLUMNS, RECORD_STATUSES, EffectiveRecord, Item
from app.people.models import Device, Participant, Study

NOW = datetime(2026, 11, 1, tzinfo=UTC)
FIRST_DAY = date(2026, 10, 1)
ONE_DAY = timedelta(days=1)
HEAD_START_SECONDS = 0.5  # of the other writer; where only one may write at a time, it is still waiting then
STUDY = uuid.UUID(int=1)


@pytest.fixture
def people(database):
    """Two participants of a study that expects after-meal pairs, with a phone each."""
    with database.write() as session:
        session.add(Study(id=STUDY, code="a", name="a", expects_after_pair=True, created_at=NOW))
        session.flush()
        participants = [
            Participant(id=uuid.UUID(int=n), study_id=STUDY, code=f"P{n}", created_at=NOW, alias=uuid.uuid4())
            for n in (2, 3)
        ]
        session.add_all(participants)
        session.flush()
        session.add_all(
            Device(id=participant.id, participant_id=participant.id, name="phone", enrolled_at=NOW)
            for participant in participants
        )
    return [participant.id for participant in participants]


def new_meal(person, day, **columns):
    captured_at = datetime(day.year, day.month, day.day, 12, tzinfo=UTC)
    values = {"details": {}, "status": "queued", "origin": "photographed", "received_at": captured_at}
    return Meal(id=uuid.uuid4(), client_id=uuid.uuid4(), study_id=STUDY, participant_id=person, device_id=person,
                captured_at=captured_at, utc_offset_minutes=0, time_zone="UTC", local_date=day,
                **values | columns)  # fmt: skip


def add_record(session, meal, **columns):
    item = Item(id=uuid.uuid4(), meal_id=meal.id, origin="declared", position=0, rings=[], relative_sd={}, flags=[])
    session.add(item)
    session.flush()
    record = EffectiveRecord(item_id=item.id, meal_id=meal.id, study_id=STUDY, participant_id=meal.participant_id,
                             captured_at=meal.captured_at, local_date=meal.local_date, change_seq=1, details={},
                             **{"status": "proposed", "consumed_g": 100.0} | columns)  # fmt: skip
    session.add(record)
    session.flush()
    return record


def marked(database):
    with database.read() as session:
        return {tuple(row) for row in session.execute(sa.select(DayMark.participant_id, DayMark.local_date))}


def read_figures(database):
    """Read all figures: rows of days, mean intakes, amounts of closed days, the study's days."""
    with database.read() as session:
        rows, after = [], None
        while page := days.page_of_days(session, RowFilter(), after=after, limit=5):
            rows += page
            after = (page[-1].local_date, page[-1].participant_id)
        means = intakes.page_of_intakes(
            session, session.get(Study, STUDY), first_day=None, last_day=None, after=None, limit=10
        )
        closed = amounts_by_column(session, StudyWindow(STUDY), "energy_kcal", least_coverage=0.0)
        study_days = study_day_sums.days_of_study(session, STUDY, FIRST_DAY - ONE_DAY, FIRST_DAY + 9 * ONE_DAY)
        return rows, means, closed, study_days


def marked_of_study(database):
    with database.read() as session:
        return set(session.scalars(sa.select(StudyDayMark.local_date)))


def start_once(monkeypatch, module, name, change, *, is_behind=False):
    """Have a function of a module start a change in a thread, before its own work or behind it; returns the thread."""
    function, threads = getattr(module, name), []

    def with_change(*arguments):
        result = function(*arguments) if is_behind else None
        if not threads:
            threads.append(threading.Thread(target=change))
            threads[0].start()
            threads[0].join(HEAD_START_SECONDS)
        return result if is_behind else function(*arguments)

    monkeypatch.setattr(module, name, with_change)
    return threads


class History:
    """Random changes of meals, records, diary entries and participants."""

    def __init__(self, database, people, seed):
        self.database, self.people, self.chance = database, people, random.Random(seed)

    def change_often(self, steps):
        for _ in range(steps):
            with self.database.write() as session:
                self.chance.choice(
                    (self.arrive, self.arrive, self.measure, self.measure, self.change_status, self.add_entry,
                     self.correct, self.delete_record, self.delete_meal, self.change_expected_days)
                )(session)  # fmt: skip

    def arrive(self, session):
        day = FIRST_DAY + timedelta(days=self.chance.randrange(4))
        place = {"location": {"latitude": 48.2, "longitude": 16.4}} if self.chance.random() < 0.5 else {}
        meal = new_meal(self.chance.choice(self.people), day, details=place,
                        origin=self.chance.choice(("photographed", "declared")))  # fmt: skip
        meal.received_at = meal.captured_at + timedelta(hours=self.chance.choice((0.1, 1, 30, 50)))
        session.add(meal)

    def measure(self, session):
        if meal := self.random_row(session, Meal):
            amounts = {name: self.amount() for name in HEADLINE_COLUMNS}
            add_record(session, meal, status=self.chance.choice(RECORD_STATUSES), consumed_g=self.amount(),
                       left_g=self.amount(), provisional=self.chance.random() < 0.2,
                       origin=self.chance.choice(("pipeline", "declared", "added")), **amounts)  # fmt: skip

    def change_status(self, session):
        if meal := self.random_row(session, Meal):
            meal.status = self.chance.choice(MEAL_STATUSES)

    def correct(self, session):
        if record := self.random_row(session, EffectiveRecord):
            name = self.chance.choice(("consumed_g", "left_g", *HEADLINE_COLUMNS))
            setattr(record, name, self.amount())
            record.status = self.chance.choice(RECORD_STATUSES)

    def add_entry(self, session):
        key = (self.chance.choice(self.people), FIRST_DAY + timedelta(days=self.chance.randrange(5)))
        day = session.get(DiaryDay, key)
        if day is None:
            day = DiaryDay(participant_id=key[0], local_date=key[1], study_id=STUDY, change_seq=1)
            session.add(day)
        day.status, day.ate_nothing = self.chance.choice((("open", False), ("closed", False), ("closed", True)))
        day.changed_at = datetime(2026, 10, 1, 18, tzinfo=UTC) + timedelta(hours=self.chance.randrange(96))

    def change_expected_days(self, session):
        person = session.get(Participant, self.chance.choice(self.people))
        day = FIRST_DAY + timedelta(days=self.chance.randrange(5))
        if self.chance.random() < 0.5:
            person.starts_on = self.chance.choice((None, day))
        else:
            person.withdrawn_at = self.chance.choice((None, datetime(2026, 10, day.day, 23, 30, tzinfo=UTC)))

    def delete_record(self, session):
        if record := self.random_row(session, EffectiveRecord):
            session.delete(record)

    def delete_meal(self, session):
        if meal := self.random_row(session, Meal):
            for model in (EffectiveRecord, Item):
                session.execute(sa.delete(model).where(model.meal_id == meal.id))
            session.expire_all()
            session.delete(meal)

    def amount(self):
        return self.chance.choice((None, 0.0, self.chance.uniform(-5.0, 500.0)))

    def random_row(self, session, model):
        rows = session.scalars(sa.select(model).order_by(*model.__table__.primary_key.columns)).all()
        return self.chance.choice(rows) if rows else None


def near(rows):
    """Flatten rows and round each number to nine digits: databases add in an order of their own."""
    return [[float(f"{x:.9g}") if isinstance(x, float) else x for x in flat(row)] for row in rows]


def flat(value):
    if isinstance(value, dict):
        value = [member for pair in sorted(value.items()) for member in pair]
    if not isinstance(value, list | tuple):
        slots = getattr(value, "__slots__", None)
        if slots is None or isinstance(value, str | uuid.UUID | date):
            return [value]
        value = [getattr(value, name) for name in slots]
    return [leaf for part in value for leaf in flat(part)]


@pytest.mark.parametrize("seed", range(2))
def test_stored_sums_equal_a_recount_after_any_history(database, people, seed):
    history = History(database, people, seed)
    for _ in range(5):
        history.change_often(12)
        counted = read_figures(database)  # some days are stored, others are counted
        write_sums(database)
        for before, after in zip(
            counted, read_figures(database), strict=True
        ):  # study days are counted from stored days
            assert near(before) == near(after)
        with database.read() as session:
            all_days = day_sums.days_after(session, None, 1000)
            truth = day_sums.counted_sums(session, all_days) if all_days else {}
        write_all_sums(database)
        assert marked(database) == set()
        with database.read() as session:
            stored = {(row.participant_id, row.local_date): row for row in session.scalars(sa.select(DaySum))}
        assert stored.keys() == truth.keys()
        for day, sums in truth.items():
            assert near([[getattr(stored[day], name) for name in sums]]) == near([list(sums.values())]), day
        for before, after in zip(counted, read_figures(database), strict=True):
            assert near(before) == near(after)
        assert marked_of_study(database) == set()
    assert compare_days(database, write=False) == ComparedDays(len(truth), 0)
    assert compare_study_days(database, write=False) == ComparedDays(len({on for _, on in truth}), 0)


def test_each_kind_of_change_marks_the_day(database, people):
    """On SQLite a migration that recreates a table drops its triggers: they must exist after all migrations."""
    person, day = people[0], FIRST_DAY
    meal = new_meal(person, day)
    changes = {
        "meal arrives": lambda session: session.add(meal),
        "meal changes status": lambda session: setattr(session.get(Meal, meal.id), "status", "failed"),
        "place is set": lambda session: setattr(session.get(Meal, meal.id), "details", {"location": {"latitude": 1}}),
        "record is added": lambda session: records.append(add_record(session, session.get(Meal, meal.id)).item_id),
        "record changes": lambda session: setattr(session.get(EffectiveRecord, records[0]), "sodium_mg", 1.0),
        "doubt is of no sum": lambda session: session.execute(
            sa.update(EffectiveRecord).values(change_seq=7, doubt=0.5)
        ),
        "stage is of no sum": lambda session: session.execute(sa.update(Meal).values(version=7, stage="segment")),
        "record is deleted": lambda session: session.delete(session.get(EffectiveRecord, records[0])),
        "entry is added": lambda session: session.add(entry),
        "entry changes": lambda session: setattr(session.get(DiaryDay, (person, day)), "status", "open"),
        "entry is deleted": lambda session: session.delete(session.get(DiaryDay, (person, day))),
        "items are deleted, which no sum tells of": lambda session: session.execute(sa.delete(Item)),
        "meal is deleted": lambda session: session.delete(session.get(Meal, meal.id)),
    }
    records = []
    entry = DiaryDay(participant_id=person, local_date=day, study_id=STUDY, status="closed", ate_nothing=False,
                     changed_at=NOW, change_seq=1)  # fmt: skip
    for name, change in changes.items():
        with database.write() as session:
            change(session)
        assert marked(database) == (set() if "no sum" in name else {(person, day)}), name
        write_all_sums(database)
        assert marked(database) == set()
    assert read_figures(database) == ([], [], [], [])


@pytest.mark.both_stores
def test_change_while_sums_are_written_is_not_lost(database, people, monkeypatch):
    with database.write() as session:
        meal = new_meal(people[0], FIRST_DAY)
        session.add(meal)
        session.flush()
        item_id = add_record(session, meal, energy_kcal=100.0).item_id

    def correct():
        with database.write() as session:
            session.get(EffectiveRecord, item_id).energy_kcal = 700.0

    writers = start_once(monkeypatch, day_sums, "lock_existing_participants", correct)  # the marks were read
    write_all_sums(database)
    writers[0].join()
    assert [row.amounts["energy_kcal"].value for row in read_figures(database)[0]] == [700.0]
    write_all_sums(database)
    assert [row.amounts["energy_kcal"].value for row in read_figures(database)[0]] == [700.0]
    assert marked(database) == set()
    assert compare_days(database, write=False) == ComparedDays(1, 0)


@pytest.mark.both_stores
def test_two_concurrent_writers_leave_no_outdated_sum(database, people, monkeypatch):
    """The second one does not get the lock, or waits for the first."""
    with database.write() as session:
        session.add(new_meal(people[0], FIRST_DAY))
    writers = start_once(monkeypatch, day_sums, "write_sums", lambda: write_all_sums(database))
    write_all_sums(database)
    writers[0].join()
    assert marked(database) == set()
    assert compare_days(database, write=False) == ComparedDays(1, 0)


def test_sums_that_cannot_be_written_raise_and_stay_marked(database, people, monkeypatch):
    """The worker logs a chore that fails; if it failed silently, pages would only get slow."""
    for n in range(2):
        with database.write() as session:
            session.add(new_meal(people[0], FIRST_DAY))
        if n == 0:
            write_all_sums(database)
    monkeypatch.setattr(day_sums, "delete_sums", lambda *_: None)
    with pytest.raises(sa.exc.IntegrityError):
        write_all_sums(database)
    assert marked(database) == {(people[0], FIRST_DAY)}
    assert [row.meals for row in read_figures(database)[0]] == [2]


def test_participant_erased_by_an_older_server_leaves_neither_sums_nor_marks(database, people):
    person = people[0]
    with database.write() as session:
        session.add(new_meal(person, FIRST_DAY))
    write_all_sums(database)
    with database.write() as session:  # as version 0.2 did, which had neither table
        for table in (Meal, Device):
            session.execute(sa.delete(table).where(table.participant_id == person))
        session.execute(sa.delete(Participant).where(Participant.id == person))
    assert read_figures(database)[0] == []
    with database.read() as session:
        assert session.scalars(sa.select(DaySum)).all() == []
    assert marked(database) == {(person, FIRST_DAY)}
    write_all_sums(database)
    assert marked(database) == set()
    with database.read() as session:
        assert session.scalars(sa.select(StudyDaySum)).all() == []
    assert marked_of_study(database) == set()


@pytest.mark.both_stores
def test_study_day_that_changes_while_it_is_written_stays_marked(database, people, monkeypatch):
    with database.write() as session:
        session.add(new_meal(people[0], FIRST_DAY))
    write_sums(database)

    def arrive():
        with database.write() as session:
            session.add(new_meal(people[1], FIRST_DAY))

    writers = start_once(monkeypatch, study_day_sums, "write_day", arrive, is_behind=True)
    write_study_sums(database)
    writers[0].join()
    assert [day.counts.meals for day in read_figures(database)[3]] == [2]
    write_all_sums(database)
    assert [day.counts.meals for day in read_figures(database)[3]] == [2]
    assert compare_study_days(database, write=False) == ComparedDays(1, 0)


@pytest.mark.both_stores
def test_wrong_missing_or_stray_sums_are_detected_and_corrected(database, people):
    with database.write() as session:
        session.add_all(new_meal(person, FIRST_DAY + n * ONE_DAY) for person in people for n in range(4))
    write_all_sums(database)
    truth = read_figures(database)
    assert compare_days(database, write=False) == ComparedDays(8, 0)
    with database.write() as session:
        session.execute(sa.update(DaySum).where(DaySum.participant_id == people[0]).values(meals=5))
        session.execute(sa.delete(DaySum).where(DaySum.local_date == FIRST_DAY))
        row = session.scalars(sa.select(DaySum)).first()
        values = {column.name: getattr(row, column.name) for column in DaySum.__table__.columns}
        session.execute(sa.insert(DaySum).values(values | {"local_date": date(2020, 1, 1)}))
    for write, compared in ((False, (9, 6)), (True, (9, 6)), (False, (8, 0))):
        assert compare_days(database, write=write) == ComparedDays(*compared)
    write_all_sums(database)
    with database.write() as session:
        session.get(StudyDaySum, (STUDY, FIRST_DAY)).meals = 5
        session.get(StudyDaySum, (STUDY, FIRST_DAY + ONE_DAY)).delays *= 2
        session.delete(session.get(StudyDaySum, (STUDY, FIRST_DAY + 2 * ONE_DAY)))
    for write, compared in ((False, (4, 3)), (True, (4, 3)), (False, (4, 0))):
        assert compare_study_days(database, write=write) == ComparedDays(*compared)
    assert read_figures(database) == truth
