"""Pages of meals by any filters: what a slow reference finds, and always from an index in their order."""

import itertools
import random
import re
import uuid
from datetime import UTC, date, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.exports.lists import meal_page_queries as meal_pages
from app.exports.lists.meal_page_queries import keys_of, search_of
from app.http.row_filter import RowFilter
from app.meals.stored.event_models import MealEvent
from app.meals.stored.models import AFTER_STATUSES, MEAL_ORIGINS, MEAL_STATUSES, Meal
from app.meals.stored.record_models import RECORD_STATUSES, EffectiveRecord, Item
from app.people.models import Study
from app.records import streams as meal_streams
from app.records.page_queries import MOST_BRANCHES
from tests.integration.exports.page_data import FIRST_DAY, FOODS, NOW, lay_ground, plan_of, some_id
from tests.support.filled_databases import fill_once

FLAGS = ([], ["low_texture"], ["food_doubtful", "low_texture"], ["low_texture_too"], ["inside_guessed"])
CODES = (None, "marker_not_found", "baseline_too_small")


@pytest.fixture
def meals(database):
    return fill_once(database, lay_meals)


def pages_of_keys(session, chosen, size=1000, *, is_newest_first=False):
    """All keys of a filter, page by page."""
    search, after = search_of(session, chosen, is_newest_first=is_newest_first), None
    while search is not None:
        keys = keys_of(session, search, after, size, is_newest_first=is_newest_first)
        if keys:
            yield keys
        if len(keys) < size:
            return
        after = keys[-1]


def lay_meals(database):
    """90 meals of three studies, with up to three records each; some of one instant, zones at both ends of the day."""
    drawn = random.Random(11)
    with database.write() as session:
        people = [*lay_ground(session, drawn)]
        return [lay_meal(session, drawn, *drawn.choice(people)) for _ in range(90)]


def lay_meal(session, drawn, study, person, device):
    """A meal as its row in the database, and as the reference sees it."""
    day, offset = FIRST_DAY + timedelta(days=drawn.randrange(4)), drawn.choice((-12, 0, 14))
    captured_at = datetime(day.year, day.month, day.day, drawn.choice((8, 20)), tzinfo=UTC) - timedelta(hours=offset)
    meal = Meal(id=some_id(drawn), client_id=some_id(drawn), study_id=study.id, participant_id=person.id,
                device_id=device.id, captured_at=captured_at, utc_offset_minutes=60 * offset, time_zone="UTC",
                local_date=day, details={}, status=drawn.choice(MEAL_STATUSES), origin=drawn.choice(MEAL_ORIGINS),
                failure_code=drawn.choice(CODES), after_status=drawn.choice((None, *AFTER_STATUSES[-2:])),
                received_at=captured_at)  # fmt: skip
    session.add(meal)
    session.flush()
    held = [record for record in lay_records(session, drawn, meal) if record.status != "rejected"]
    return {
        "key": (captured_at, meal.id), "study": study.code, "study_id": study.id, "person": person.code,
        "person_id": person.id, "day": day, "status": meal.status, "origin": meal.origin, "failure": meal.failure_code,
        "after": meal.after_status, "foods": {FOODS[record.food_id] for record in held},
        "flags": {flag for record in held for flag in record.flags}, "review": any(not r.reviewed for r in held),
        "answer": lay_words(session, drawn, meal),
    }  # fmt: skip


def lay_records(session, drawn, meal):
    for position in range(drawn.randrange(4)):
        item = Item(id=some_id(drawn), meal_id=meal.id, origin="declared", position=position, rings=[],
                    relative_sd={}, flags=[])  # fmt: skip
        session.add(item)
        session.flush()
        record = EffectiveRecord(
            item_id=item.id, meal_id=meal.id, study_id=meal.study_id, participant_id=meal.participant_id,
            captured_at=meal.captured_at, local_date=meal.local_date, status=drawn.choice(RECORD_STATUSES),
            food_id=drawn.choice(list(FOODS)), flags=drawn.choice(FLAGS), details={}, change_seq=1,
            reviewed=drawn.random() < 0.8,
        )  # fmt: skip
        session.add(record)
        yield record


def lay_words(session, drawn, meal):
    """Questions, answers and what was taken back; whether a question is open."""
    numbers = itertools.count(1)

    def say(word, **new):
        event = MealEvent(id=some_id(drawn), meal_id=meal.id, sequence=next(numbers), kind=word, layer="reviewer",
                          old={}, new=new, request_sha256="0" * 64, created_at=NOW)  # fmt: skip
        session.add(event)
        session.flush()
        return str(event.id)

    told = drawn.choice(("nothing", "nothing", "asked", "answered", "answer undone", "taken back", "two"))
    if told == "nothing":
        return False
    question = say("question", text="Peeled?")
    if told == "two":
        say("question", text="All of it?")
    if told == "taken back":
        say("undo", event=question)
    if told in ("answered", "answer undone", "two"):
        answer = say("answer", question=question, text="Yes.")
        if told == "answer undone":
            say("undo", event=answer)
    return told in ("asked", "answer undone", "two")


VALUES = {
    "study_code": (None, "a", "none"),
    "participant_code": (None, None, "P001", "P-b"),
    "first_day": (None, FIRST_DAY + timedelta(days=1), date.min),
    "last_day": (None, FIRST_DAY + timedelta(days=2), date.max),
    "statuses": ((), (), ("failed",), ("confirmed", "processing", "failed")),
    "origin": (None, None, "declared"),
    "failure_codes": ((), (), ("marker_not_found",), ("no_such",), CODES[1:]),
    "after_statuses": ((), (), ("failed",)),
    "food_keys": ((), (), ("apple",), ("pear", "no such")),
    "flags": ((), (), ("low_texture",), ("inside_guessed", "no_such")),
    "needs": (None, None, "review", "answer"),
}


def reference(meals, chosen):
    """What the filters leave, one meal at a time."""

    def holds(meal):
        return (
            chosen.study_code in (None, meal["study"])
            and chosen.participant_code in (None, meal["person"])
            and chosen.participant_id in (None, meal["person_id"])
            and (chosen.study_ids is None or meal["study_id"] in chosen.study_ids)
            and (chosen.first_day or date.min) <= meal["day"] <= (chosen.last_day or date.max)
            and (not chosen.statuses or meal["status"] in chosen.statuses)
            and chosen.origin in (None, meal["origin"])
            and (not chosen.failure_codes or meal["failure"] in chosen.failure_codes)
            and (not chosen.after_statuses or meal["after"] in chosen.after_statuses)
            and (not chosen.food_keys or not meal["foods"].isdisjoint(chosen.food_keys))
            and (not chosen.flags or not meal["flags"].isdisjoint(chosen.flags))
            and (chosen.needs is None or meal[chosen.needs])
        )

    return sorted(meal["key"] for meal in meals if holds(meal))


def some_filters(meals):
    """Every fourth pair of values of different filters, and a hundred of more."""
    drawn = random.Random(3)
    studies = frozenset({meal["study_id"] for meal in meals if meal["study"] != "c"})
    yield RowFilter()
    pairs = (
        RowFilter(**dict(zip(names, values, strict=True)))
        for names in itertools.combinations(VALUES, 2)
        for values in itertools.product(*(VALUES[name] for name in names))
    )
    yield from itertools.islice(dict.fromkeys(pairs), 0, None, 4)
    for _ in range(60):
        some = {name: drawn.choice(values) for name, values in VALUES.items() if drawn.random() < 0.4}
        yield RowFilter(**some, study_ids=drawn.choice((None, studies)))


LIMITS = {
    "as they are": {},
    "many branches": {"MOST_PLANNED": 1},
    "few branches": {"MOST_BRANCHES": 3, "MOST_BY_ARRAYS": 3},
    "flags not looked up": {"MOST_LISTS": 1},
    "one meal looked at": {"SAMPLED": 1},
}


@pytest.mark.parametrize("limits", LIMITS.values(), ids=LIMITS)
def test_any_filters_leave_the_meals_that_a_slow_reference_finds(database, meals, monkeypatch, limits):
    for name, value in limits.items():
        monkeypatch.setattr(meal_streams if name == "MOST_PLANNED" else meal_pages, name, value)
    found = 0
    with database.read() as session:
        for chosen in itertools.islice(dict.fromkeys(some_filters(meals)), 0, None, 4 if limits else 1):
            expected = reference(meals, chosen)
            search = search_of(session, chosen)
            keys = [] if search is None else keys_of(session, search, None, 100, is_newest_first=True)
            assert keys == expected[::-1], chosen
            found += len(keys)
    assert found > 150  # the filters do leave something


def test_meals_of_more_studies_than_a_statement_has_branches_are_all_there(database, meals):
    """An admin sees all studies; those with meals are the last of them here."""
    numbers = range(MOST_BRANCHES)
    empty = [{"id": uuid.UUID(int=n), "code": str(n), "name": "empty", "created_at": NOW} for n in numbers]
    with database.write() as session:
        session.execute(sa.insert(Study), empty)
    with database.read() as session:
        for named in ({}, {"origin": "declared"}, {"failure_codes": ("marker_not_found",)}, {"needs": "review"}):
            expected = reference(meals, RowFilter(**named))
            assert [key for page in pages_of_keys(session, RowFilter(**named)) for key in page] == expected != []


@pytest.mark.both_stores
def test_where_there_is_no_study_there_is_no_meal(database):
    with database.read() as session:
        for chosen in (RowFilter(), RowFilter(statuses=("failed",)), RowFilter(needs="answer")):
            assert list(pages_of_keys(session, chosen)) == []


@pytest.mark.parametrize("is_newest_first", [True, False], ids=["newest", "oldest"])
def test_pages_of_meals_follow_each_other_without_gap_or_repeat(database, meals, is_newest_first):
    for chosen in (
        RowFilter(),
        RowFilter(study_code="a", food_keys=("apple", "pear")),
        RowFilter(needs="review", flags=("low_texture",)),
        RowFilter(participant_code="P001"),
    ):
        with database.read() as session:
            pages = list(pages_of_keys(session, chosen, size=2, is_newest_first=is_newest_first))
        assert {len(page) for page in pages[:-1]} == {2}
        assert [key for page in pages for key in page] == sorted(reference(meals, chosen), reverse=is_newest_first)


@pytest.mark.usefixtures("meals")
@pytest.mark.parametrize(
    ("named", "index"),
    [
        ({}, "ix_meal_study_id_captured_at_id"),
        ({"first_day": FIRST_DAY, "last_day": FIRST_DAY}, "ix_meal_study_id_captured_at_id"),
        ({"statuses": ("failed", "confirmed")}, "ix_meal_list_of_status"),
        ({"origin": "declared", "first_day": FIRST_DAY}, "ix_meal_list_of_status"),
        ({"failure_codes": ("marker_not_found",)}, "ix_meal_list_of_failure"),
        ({"after_statuses": ("failed", "nothing_left")}, "ix_meal_list_of_after"),
        ({"food_keys": ("apple",)}, "ix_effective_record_meals_of_food"),
        ({"flags": ("low_texture",), "last_day": FIRST_DAY}, "ix_effective_record_meals_of_flags"),
        ({"needs": "review"}, "ix_effective_record_look_meals"),
        ({"participant_code": "P001", "flags": ("low_texture",)}, "ix_meal_list_of_participant"),
    ],
    ids=["none", "days", "status", "origin", "failure", "after", "food", "flag", "review", "participant"],
)
def test_no_page_of_meals_sorts_or_reads_a_whole_table(database, named, index):
    chosen = RowFilter(study_code="a", **named)
    with database.read() as session:
        search = search_of(session, chosen)
        plan = plan_of(session, sa.select(search.page((NOW, uuid.UUID(int=0)), 100)))
    steps = " | ".join(plan)
    assert index in steps, steps
    assert "TEMP B-TREE" not in steps, steps
    assert not re.search(r"SCAN (meal|effective_record)\b", steps), steps
