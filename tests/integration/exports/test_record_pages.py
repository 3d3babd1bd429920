"""Pages of records by any filters: what a slow reference finds, and always from an index in their order."""

import itertools
import random
import re
import uuid
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.diary import queries as days
from app.diary.queries import page_of_days
from app.foods.models import Food, FoodRelease
from app.http.row_filter import RowFilter
from app.meals.stored.event_models import DiaryDay
from app.meals.stored.models import Meal
from app.meals.stored.record_models import RECORD_STATUSES, EffectiveRecord, Item
from app.records import page_queries as record_pages
from app.records.page_queries import search_of
from app.records.review import queries as review
from app.records.review.queries import QueueFilter, page_of_queue, queue_keys
from tests.integration.exports.page_data import FIRST_DAY, FOODS, NOW, lay_ground, plan_of, some_id
from tests.support.filled_databases import fill_once


@pytest.fixture
def eaten(database):
    return fill_once(database, lay_records)


def lay_records(database):
    """60 records of three studies, two people of one code, foods in two releases, zones at both ends of the day."""
    drawn = random.Random(7)
    with database.write() as session:
        people = [*lay_ground(session, drawn)]
        rows = [lay_record(session, drawn, *drawn.choice(people)) for _ in range(60)]
        study, person, _ = people[0]
        session.add(DiaryDay(participant_id=person.id, local_date=FIRST_DAY - timedelta(days=1), id=uuid.uuid4(),
                             study_id=study.id, status="closed", version=1, changed_at=NOW, change_seq=1,
                             ate_nothing=True))  # fmt: skip
    return rows


def lay_record(session, drawn, study, person, device):
    """A record of a meal of its own, as the reference sees it."""
    day, offset = FIRST_DAY + timedelta(days=drawn.randrange(4)), drawn.choice((-12, 0, 14))
    captured_at = datetime(day.year, day.month, day.day, drawn.randrange(24), tzinfo=UTC) - timedelta(hours=offset)
    meal = Meal(id=uuid.uuid4(), client_id=uuid.uuid4(), study_id=study.id, participant_id=person.id,
                device_id=device.id, captured_at=captured_at, utc_offset_minutes=60 * offset, time_zone="UTC",
                local_date=day, details={}, status="estimated", received_at=captured_at)  # fmt: skip
    session.add(meal)
    session.flush()
    item = Item(id=some_id(drawn), meal_id=meal.id, origin="declared", position=0, rings=[], relative_sd={}, flags=[])
    session.add(item)
    session.flush()
    food, told = drawn.choice(list(FOODS)), {"status": drawn.choice(RECORD_STATUSES)}
    told |= {"doubt": drawn.choice((0.0, 0.5, 1.0)), "reviewed": drawn.random() < 0.3}
    told |= {"provisional": drawn.random() < 0.3}
    session.add(EffectiveRecord(item_id=item.id, meal_id=meal.id, study_id=study.id, participant_id=person.id,
                                captured_at=captured_at, local_date=day, food_id=food, flags=[], details={},
                                change_seq=1, **told))  # fmt: skip
    key = {"key": (captured_at, item.id), "day": day, "food": FOODS[food]}
    person = {"study": study.code, "study_id": study.id, "person": person.code, "person_id": person.id}
    return key | person | told


VALUES = {
    "study_code": (None, "a", "none"),
    "participant_code": (None, "P001", "P-b"),
    "first_day": (None, FIRST_DAY + timedelta(days=1), date.min),
    "last_day": (None, FIRST_DAY + timedelta(days=2), date.max),
    "food_keys": ((), ("apple",), ("pear", "apple", "no such")),
    "statuses": ((), ("rejected",), ("confirmed", "proposed")),
    "some_studies": (False, True),
}


def reference(rows, chosen):
    """What the filters leave, one row at a time."""

    def holds(row):
        return (
            chosen.study_code in (None, row["study"])
            and chosen.participant_code in (None, row["person"])
            and (chosen.study_ids is None or row["study_id"] in chosen.study_ids)
            and (chosen.first_day or date.min) <= row["day"] <= (chosen.last_day or date.max)
            and (not chosen.food_keys or row["food"] in chosen.food_keys)
            and (not chosen.statuses or row["status"] in chosen.statuses)
        )

    return [key for key, row in sorted((row["key"], row) for row in rows if holds(row))]


def filters(rows):
    """All combinations of VALUES."""
    studies = frozenset({row["study_id"] for row in rows if row["study"] != "c"})
    for values in itertools.product(*VALUES.values()):
        named = dict(zip(VALUES, values, strict=True))
        is_some = named.pop("some_studies")
        yield RowFilter(**named, study_ids=studies if is_some else None)


@pytest.mark.parametrize(("most_branches", "most_planned"), [(256, 8), (256, 1), (3, 8)])
def test_any_filters_leave_what_a_slow_reference_finds(database, eaten, monkeypatch, most_branches, most_planned):
    monkeypatch.setattr(record_pages, "MOST_BRANCHES", most_branches)  # 3: few are branches, the rest conditions
    monkeypatch.setattr(record_pages, "MOST_PLANNED", most_planned)
    found = 0
    with database.read() as session:
        for chosen in itertools.islice(filters(eaten), 0, None, 11):
            expected = reference(eaten, chosen)
            search = search_of(session, chosen)
            keys = [] if search is None else [tuple(row) for row in session.execute(sa.select(search.page(None, 100)))]
            assert sorted(keys) == expected, chosen
            found += len(keys)
    assert found > 200  # the filters do leave something


@pytest.mark.both_stores
@pytest.mark.usefixtures("eaten")
@pytest.mark.parametrize(
    "chosen",
    [
        RowFilter(),
        RowFilter(first_day=FIRST_DAY, last_day=FIRST_DAY),
        RowFilter(study_code="a"),
        RowFilter(study_code="a", first_day=FIRST_DAY),
        RowFilter(statuses=("rejected", "confirmed")),
        RowFilter(study_code="a", statuses=("rejected",)),
        RowFilter(food_keys=("apple",)),
        RowFilter(study_code="a", food_keys=("apple", "pear"), statuses=("rejected",)),
        RowFilter(participant_code="P-b", food_keys=("apple",), statuses=("rejected",)),
    ],
    ids=lambda chosen: "+".join(name for name in RowFilter.__slots__ if getattr(chosen, name)) or "none",
)
def test_no_page_sorts_or_reads_a_whole_table(database, chosen):
    after = (NOW - timedelta(days=60), uuid.UUID(int=0))
    with database.read() as session:
        search = search_of(session, chosen)
        plan = plan_of(session, sa.select(search.page(after, 100)))
    steps = " | ".join(plan)
    assert "captured_at" in steps
    if database.is_sqlite:
        assert "TEMP B-TREE" not in steps, steps
        assert not [step for step in plan if step == "SCAN effective_record"], steps
    else:
        sorts = [step for step in plan if "Key" not in step and step.removeprefix("->  ").startswith(("Sort", "Incr"))]
        # pages of branches that come as arrays are sorted once: of each there are no more rows than a page has
        assert len(sorts) == (len(search.branches) > record_pages.MOST_PLANNED), steps
        assert not sorts or re.search(r"Sort Key.* Nested Loop \| ->  Function Scan .* ->  Limit \| ->  Index", steps)
        assert "Seq Scan" not in steps, steps


@pytest.mark.parametrize("most_branches", [256, 1])
def test_pages_of_days_are_those_of_meals_and_words_in_their_order(database, eaten, monkeypatch, most_branches):
    monkeypatch.setattr(days, "MOST_BRANCHES", most_branches)
    every = {(row["day"], row["person_id"]): row for row in eaten}
    with database.read() as session:
        word = session.scalars(sa.select(DiaryDay)).one()
        person = next(row for row in eaten if row["study"] == "a" and row["person"] == "P001")
        assert word.participant_id == person["person_id"]
        every[word.local_date, word.participant_id] = person
        for study, code, first in itertools.product((None, "a", "none"), (None, "P001"), (None, FIRST_DAY)):
            expected = sorted(
                key
                for key, row in every.items()
                if study in (None, row["study"]) and code in (None, row["person"]) and key[0] >= (first or date.min)
            )
            chosen = RowFilter(study_code=study, participant_code=code, first_day=first)
            seen, after = [], None
            while page := page_of_days(session, chosen, after=after, limit=9):
                after = (page[-1].local_date, page[-1].participant_id)
                seen += [(day.local_date, day.participant_id) for day in page]
            assert seen == expected, chosen


QUEUE_VALUES = {
    "status": (None, "needs_review"),
    "food_key": (None, "apple", "no such"),
    "min_doubt": (None, 0.5),
    "provisional": (None, True, False),
    "participant_code": (None, "P001", "no such"),
}


def queue_filters(rows):
    """All combinations of QUEUE_VALUES, of the study "a"."""
    study_id = next(row["study_id"] for row in rows if row["study"] == "a")
    for values in itertools.product(*QUEUE_VALUES.values()):
        yield QueueFilter(study_id, **dict(zip(QUEUE_VALUES, values, strict=True)))


def queue_reference(rows, chosen):
    """What waits for a reviewer, one row at a time."""

    def waits(row):
        return (
            row["study_id"] == chosen.study_id
            and not row["reviewed"]
            and row["status"] != "rejected"
            and chosen.status in (None, row["status"])
            and chosen.food_key in (None, row["food"])
            and row["doubt"] >= (chosen.min_doubt or 0.0)
            and chosen.provisional in (None, row["provisional"])
            and chosen.participant_code in (None, row["person"])
        )

    return sorted(((row["doubt"], row["key"][1]) for row in rows if waits(row)), reverse=True)


@pytest.mark.parametrize("most_branches", [256, 1])
def test_any_filters_leave_the_queue_that_a_slow_reference_finds(database, eaten, monkeypatch, most_branches):
    monkeypatch.setattr(review, "MOST_BRANCHES", most_branches)
    found = 0
    with database.read() as session:
        for chosen in itertools.islice(queue_filters(eaten), 0, None, 2):
            expected, seen, after = queue_reference(eaten, chosen), [], None
            while page := page_of_queue(session, chosen, after=after, limit=3):
                after = (page[-1].record.doubt, page[-1].record.item_id)
                seen += [(row.record.doubt, row.record.item_id) for row in page]
            assert seen == expected, chosen
            found += len(seen)
    assert found > 30  # the filters do leave something


def test_queue_of_a_food_with_very_many_versions_is_read(database, eaten):
    """More of them than SQLite takes queries in one compound (500): four statuses of each."""
    with database.write() as session:
        for number in range(3, 133):
            session.add(FoodRelease(id=number, source="test", name="table", version=str(number), released_on=FIRST_DAY,
                                    checksum=f"{number:064}", imported_at=NOW, completed_at=NOW))  # fmt: skip
            session.flush()
            session.add(Food(id=10 * number, release_id=number, key="apple", name="apple", aliases=[],
                             food_group="all", form="ball", refuse=[], probes=[], source_ids={}))  # fmt: skip
    chosen = replace(next(queue_filters(eaten)), food_key="apple")
    with database.read() as session:
        page = page_of_queue(session, chosen, after=None, limit=100)
    assert [(row.record.doubt, row.record.item_id) for row in page] == queue_reference(eaten, chosen) != []


@pytest.mark.parametrize(
    ("named", "index"),
    [
        ({}, "look_queue"),
        ({"status": "needs_review", "min_doubt": 0.1}, "look_queue"),
        ({"food_key": "apple"}, "queue_of_food"),
        ({"food_key": "apple", "status": "proposed", "provisional": False}, "queue_of_food"),
        ({"provisional": True}, "queue_of_provisional"),
    ],
    ids=["none", "status", "food", "food+status", "provisional"],
)
def test_no_page_of_the_queue_sorts_or_passes_by_what_others_wait_for(database, eaten, named, index):
    chosen = next(queue_filters(eaten))
    with database.read() as session:
        keys = queue_keys(session, replace(chosen, **named), after=(0.9, uuid.UUID(int=0)), limit=50)
        steps = " | ".join(plan_of(session, sa.select(keys)))
    assert f"ix_effective_record_{index}" in steps, steps
    assert "TEMP B-TREE" not in steps, steps
