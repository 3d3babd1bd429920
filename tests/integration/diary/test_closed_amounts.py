"""Amounts of closed days are the same from the headline columns and from the food table, after any history."""

import random
import uuid
from datetime import UTC, date, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.diary.adequacy import closed_amounts, contents_of_days
from app.diary.day_definition import days_of_study
from app.foods.models import Component, Food, FoodNutrient, FoodRelease
from app.meals.stored.event_models import DiaryDay
from app.meals.stored.models import MEAL_STATUSES, Meal
from app.meals.stored.record_models import RECORD_STATUSES, EffectiveRecord, Item
from app.people.models import Device, Participant, Study

NOW = datetime(2026, 11, 1, tzinfo=UTC)
FIRST_DAY = date(2026, 9, 28)
DAYS = 6
STUDY, OTHER_STUDY = uuid.UUID(int=1), uuid.UUID(int=2)
PER_100_G = {1: 53.2, 2: 0.0, 3: None}  # of vitamin C, by food
VITAMIN_C = "401"


@pytest.fixture
def people(database):
    """Four participants of a study, one without a profile, and one of another; with a phone each."""
    with database.write() as session:
        session.add_all(Study(id=study, code=str(study), name="a", created_at=NOW) for study in (STUDY, OTHER_STUDY))
        session.add(FoodRelease(id=1, source="test", name="t", version="1", released_on=FIRST_DAY, checksum="1",
                                imported_at=NOW, completed_at=NOW))  # fmt: skip
        session.flush()
        component = session.scalar(sa.select(Component).where(Component.number == VITAMIN_C))
        if component is None:
            component = Component(number=VITAMIN_C, name="Vitamin C", unit="mg", tagname="VITC")
            session.add(component)
        for food, content in PER_100_G.items():
            session.add(Food(id=food, release_id=1, key=str(food), name="a food", food_group="all", form="heap",
                             aliases=[], refuse=[], probes=[], source_ids={}))  # fmt: skip
            session.flush()
            if content is not None:
                session.add(FoodNutrient(food_id=food, component_id=component.id, per_100_g=content))
        participants = [
            Participant(id=uuid.UUID(int=n), study_id=OTHER_STUDY if n == 14 else STUDY, code=f"P{n}", created_at=NOW,
                        alias=uuid.uuid4(), profile=None if n == 12 else {"birth_year": 1970 + n, "sex": "male"})
            for n in range(10, 15)
        ]  # fmt: skip
        session.add_all(participants)
        session.flush()
        session.add_all(
            Device(id=participant.id, participant_id=participant.id, name="phone", enrolled_at=NOW)
            for participant in participants
        )
    return [(participant.id, participant.study_id) for participant in participants]


def change_at_random(session, people, chance):
    """Add a random meal with items, or a random diary entry."""
    person, study = chance.choice(people)
    day = FIRST_DAY + timedelta(days=chance.randrange(DAYS))
    if chance.random() < 0.5:
        entry = session.get(DiaryDay, (person, day))
        if entry is None:
            entry = DiaryDay(participant_id=person, local_date=day, study_id=study, change_seq=1, changed_at=NOW)
            session.add(entry)
        entry.status, entry.ate_nothing = chance.choice((("open", False), *3 * [("closed", False)], ("closed", True)))
        return
    captured_at = datetime(day.year, day.month, day.day, 12, tzinfo=UTC)
    meal = Meal(id=uuid.uuid4(), client_id=uuid.uuid4(), study_id=study, participant_id=person, device_id=person,
                captured_at=captured_at, utc_offset_minutes=0, time_zone="UTC", local_date=day, details={},
                status=chance.choice((*MEAL_STATUSES, *9 * ["confirmed"])), origin="photographed",
                received_at=captured_at)  # fmt: skip
    session.add(meal)
    session.flush()
    for _ in range(chance.randrange(4)):
        item = Item(id=uuid.uuid4(), meal_id=meal.id, origin="declared", position=0, rings=[], relative_sd={}, flags=[])
        session.add(item)
        session.flush()
        grams = chance.choice((None, 0.0, -2.0, *9 * [chance.uniform(1.0, 400.0)]))
        food = chance.choice((None, 1, 1, 1, 2, 3))
        content = PER_100_G.get(food)
        session.add(
            EffectiveRecord(
                item_id=item.id, meal_id=meal.id, study_id=study, participant_id=person, captured_at=captured_at,
                local_date=day, change_seq=1, details={}, status=chance.choice((*RECORD_STATUSES, *5 * ["confirmed"])),
                food_id=food, consumed_g=grams, provisional=chance.random() < 0.05, origin="declared",
                vitamin_c_mg=None if grams is None or content is None else grams * content / 100.0,
            )
        )  # fmt: skip


def both_ways(database, least_coverage, first_day=None, last_day=None):
    """Return (profile, last day, days, amounts) of each participant, from columns and from the table."""
    chosen = days_of_study(STUDY, first_day, last_day)
    with database.read() as session:
        quick = closed_amounts(session, chosen, column="vitamin_c_mg", least_coverage=least_coverage)
        contents = contents_of_days(session, chosen, VITAMIN_C, None)
        slow = closed_amounts(session, chosen, contents=contents, least_coverage=least_coverage)
    return [[(row.profile, row.last_day, row.days, row.amounts) for row in way] for way in (quick, slow)]


@pytest.mark.parametrize("seed", range(2))
def test_amounts_of_a_column_equal_those_from_the_food_table(database, people, seed):
    chance = random.Random(seed)
    cases = set()
    for _ in range(4):
        with database.write() as session:
            for _change in range(25):
                change_at_random(session, people, chance)
        for least_coverage in (0.9, 0.3):
            for window in ((None, None), (FIRST_DAY + timedelta(days=2), FIRST_DAY + timedelta(days=4))):
                quick, slow = both_ways(database, least_coverage, *window)
                assert [row[:3] for row in quick] == [row[:3] for row in slow]
                for (*_, days, amounts), (*_, expected) in zip(quick, slow, strict=True):
                    assert amounts == pytest.approx(expected, rel=1e-9, abs=1e-9)  # in the order of the days
                    cases.add((len(amounts) == days, sum(amount > 0.0 for amount in amounts) > 1))
    assert cases >= {(True, True), (False, True)}  # participants with and without unknown days, some of them eaten
