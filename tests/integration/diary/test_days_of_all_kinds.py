"""Days of all kinds: pages (diary/day_definition.py) and files (exports/views) have the same, to the last digit."""

import contextlib
import random
import uuid
from datetime import UTC, datetime, timedelta

import pytest

from app.diary.queries import page_of_days
from app.exports.lists.day_values import day_values
from app.exports.live_tables import live_tables
from app.http.row_filter import RowFilter
from app.meals.stored.event_models import DayEvent, DiaryDay
from app.meals.stored.models import MEAL_STATUSES, Meal
from app.meals.stored.record_models import RECORD_STATUSES, EffectiveRecord, Item
from app.nutrition.components import HEADLINE_COLUMNS
from app.people.models import Device, Participant, Study

NOON = datetime(2026, 10, 1, 12, tzinfo=UTC)
DAYS = 60
STUDY = uuid.UUID(int=1)
PROFILE = {"sex": "female", "birth_year": 1990, "weight_kg": 60.0, "height_cm": 165.0}


class History:
    """Random meals, records and diary entries of two participants."""

    def __init__(self, session, seed):
        self.session, self.chance = session, random.Random(seed)
        session.add(Study(id=STUDY, code="a", name="a", expects_after_pair=seed % 2 == 0, created_at=NOON))
        session.flush()
        for number, profile in ((2, PROFILE), (3, None)):
            person = uuid.UUID(int=number)
            participant = Participant(id=person, study_id=STUDY, code=f"P{number}", profile=profile)
            participant.created_at, participant.alias = NOON, uuid.uuid4()
            session.add(participant)
            session.flush()
            session.add(Device(id=person, participant_id=person, name="phone", enrolled_at=NOON))
            session.flush()
            for day in range(DAYS):
                self.add_entry(person, NOON.date() + timedelta(days=day))
                for _ in range(self.chance.choice((0, 1, 1, 2))):
                    self.add_meal(person, NOON + timedelta(days=day))

    def add_entry(self, person, day):
        status, ate_nothing = self.chance.choice((*3 * [("closed", False)], ("closed", True), ("open", False)))
        if self.chance.random() < 0.8:
            changed_at = NOON + timedelta(days=(day - NOON.date()).days, hours=self.chance.randrange(30))
            entry = DiaryDay(participant_id=person, local_date=day, study_id=STUDY, change_seq=1)
            entry.status, entry.ate_nothing, entry.changed_at = status, ate_nothing, changed_at
            layer = self.chance.choice(("participant", "reviewer"))
            event = DayEvent(id=uuid.uuid4(), participant_id=person, local_date=day, kind="closed", layer=layer)
            event.author, event.created_at = "somebody", changed_at
            self.session.add_all((entry, event))

    def add_meal(self, person, captured_at):
        meal = Meal(id=uuid.uuid4(), client_id=uuid.uuid4(), study_id=STUDY, participant_id=person, device_id=person)
        meal.captured_at, meal.utc_offset_minutes, meal.time_zone = captured_at, 0, "UTC"
        meal.local_date, meal.details = captured_at.date(), {}
        meal.status = self.chance.choice((*MEAL_STATUSES, *5 * ["confirmed"]))
        meal.origin = self.chance.choice(("photographed", "declared"))
        meal.received_at = captured_at + timedelta(microseconds=self.chance.randrange(2 * 86_400_000_000))
        self.session.add(meal)
        self.session.flush()
        is_plain = self.chance.random() < 0.5
        for _ in range(self.chance.randrange(4)):
            self.add_record(meal, is_plain)

    def add_record(self, meal, is_plain):
        item = Item(id=uuid.uuid4(), meal_id=meal.id, origin="declared", position=0, rings=[], relative_sd={}, flags=[])
        self.session.add(item)
        self.session.flush()
        record = EffectiveRecord(item_id=item.id, meal_id=meal.id, study_id=STUDY, participant_id=meal.participant_id)
        record.captured_at, record.local_date = meal.captured_at, meal.local_date
        record.origin = self.chance.choice(("pipeline", "declared", "added"))
        record.change_seq, record.details = 1, {}
        record.status = self.chance.choice((*RECORD_STATUSES, *5 * ["confirmed"]))
        record.provisional = not is_plain and self.chance.random() < 0.3
        record.left_g = self.chance.choice((None, 1.0))
        for name in ("consumed_g", *HEADLINE_COLUMNS):
            amount = self.chance.uniform(-5.0, 900.0)
            known = 9 if name == "consumed_g" else 3
            setattr(record, name, amount if is_plain else self.chance.choice((None, 0.0, *known * [amount])))
        self.session.add(record)


def days_of_files(database, folder):
    """Rows of the view. A copy of SQLite's file is read: this process holds locks on the file itself."""
    url = database.url
    if database.is_sqlite:
        url = f"sqlite:///{folder / 'copy.sqlite'}"
        with contextlib.closing(database.write_engine.raw_connection()) as connection:
            connection.cursor().execute(f"VACUUM INTO '{folder / 'copy.sqlite'}'")
    with live_tables(url, folder) as connection:
        found = connection.execute("SELECT * FROM days ORDER BY local_date, participant_id")
        names = [column[0] for column in found.description]
        return [dict(zip(names, row, strict=True)) for row in found.fetchall()]


@pytest.mark.both_stores
@pytest.mark.parametrize("seed", range(2))
def test_days_of_all_kinds_are_the_same_on_pages_and_in_files(database, tmp_path, seed):
    with database.write() as session:
        History(session, seed)
    with database.read() as session:
        pages, after = [], None
        while page := page_of_days(session, RowFilter(), after=after, limit=7):
            pages += page
            after = (page[-1].local_date, page[-1].participant_id)
    in_files = days_of_files(database, tmp_path)
    assert len(pages) == len(in_files) > DAYS
    for day, row in zip(pages, in_files, strict=True):
        values = day_values(day)
        assert {name: row[name] for name in values} == values
        assert row["is_complete"] == day.is_complete
        assert row["whole_energy_kcal"] == day.whole_amount("energy_kcal")
    kinds = {(day.status, day.is_nothing, day.is_complete, day.unmeasured_meals > 0) for day in pages}
    assert len(kinds) >= 5
    shares = {day.amount("fat_g").coverage for day in pages}
    assert {None, 1.0} < shares
    assert any(0.0 < share < 1.0 for share in shares - {None})
