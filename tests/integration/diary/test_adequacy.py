"""Group adequacy from days in the database: by life stage, sums from the food table, and when it is not told."""

import uuid
from datetime import UTC, date, datetime, timedelta

import numpy as np
import pytest
import sqlalchemy as sa

from app.foods.models import Component, Food, FoodNutrient
from app.meals.stored.event_models import DiaryDay
from app.nutrition.components import HEADLINES
from app.people.models import Participant, Study
from tests.integration.diary.eaten_days import add_meal, eaten_item

PATH = "/v1/studies/pilot/adequacy"
MAN = {"sex": "male", "birth_year": 1986, "weight_kg": 80.0}
FIRST = date(2026, 11, 1)


def content_of(state, food, number):
    """What 100 g of a food hold of a component, by the food table."""
    with state.database.read() as session:
        query = (
            sa.select(FoodNutrient.per_100_g)
            .join(Component)
            .join(Food, Food.id == FoodNutrient.food_id)
            .where(Food.key == food, Component.number == number)
        )
        return session.scalars(query).first()


def contents_of(state, food="apple"):
    return {headline.column: content_of(state, food, headline.numbers[0]) for headline in HEADLINES}


def eaten(contents, grams, food="apple", **columns):
    """A record of so many grams with what they hold by the food table, as the server writes it."""
    amounts = {column: None if each is None else grams * each / 100.0 for column, each in contents.items()}
    return eaten_item(grams, food, **amounts, **columns)


def phone_owner(state):
    """The participant who has a phone: the others' meals go by its name."""
    with state.database.read() as session:
        return session.scalars(sa.select(Participant.id).where(Participant.code == "P001")).one()


def add_people(state, grams_by_person, profile, prefix="M", food="apple"):
    """Participants who ate so many grams of a food on each of their closed days."""
    owner, contents = phone_owner(state), contents_of(state, food)
    for place, grams in enumerate(grams_by_person):
        code = f"{prefix}{place:03}"
        with state.database.write() as session:
            study = session.query(Study).one()
            person = Participant(
                id=uuid.uuid4(), study_id=study.id, code=code, profile=profile, created_at=study.created_at
            )
            session.add(person)
            session.flush()
            closed = {"status": "closed", "changed_at": datetime(2026, 11, 20, tzinfo=UTC), "ate_nothing": False}
            days = [FIRST + timedelta(days=number) for number in range(len(grams))]
            session.add_all(
                DiaryDay(participant_id=person.id, local_date=day, study_id=study.id, change_seq=1, **closed)
                for day in days
            )
        for day, amount in zip(days, grams, strict=True):
            add_meal(state, code, day, eaten(contents, float(amount), food), device_of=owner)


@pytest.fixture
def group(phone, state):
    """Twelve men of three days each, who eat apples only; the vitamin C that they eat, (12, 3), mg."""
    rng = np.random.default_rng(1)
    grams = np.maximum(rng.normal(2000.0, 500.0, (12, 1)) + rng.normal(0.0, 300.0, (12, 3)), 100.0)
    add_people(state, grams, MAN)
    return grams * content_of(state, "apple", "401") / 100.0


def asked(client, admin, component, **params):
    answer = client.get(PATH, headers=admin, params={"component": component} | params)
    assert answer.status_code == 200
    return answer.json()


def test_group_is_judged_by_the_contents_of_its_foods(group, state, client, admin):
    body = asked(client, admin, "VITC")
    assert (body["number"], body["unit"], body["persons_without_stage"]) == ("401", "mg", 0)
    (men,) = body["groups"]
    assert (men["life_stage"], men["persons"], men["days"], men["days_left_out"]) == ("male_31_50", 12, 36, 0)
    assert (men["ear"], men["per"], men["reason"]) == (75.0, "day", None)
    assert men["unadjusted_share"] == pytest.approx(float(np.mean(group.mean(axis=1) < 75.0)))
    assert men["share_interval"][0] <= men["share_below_ear"] <= men["share_interval"][1]
    assert men["mean_usual_intake"] == pytest.approx(group.mean(), rel=0.05)
    assert men["variances"]["within"] > 0
    assert asked(client, admin, "401") == asked(client, admin, "vitamin_c_mg") == body
    (protein,) = asked(client, admin, "PROCNT")["groups"]
    assert (protein["ear"], protein["per"]) == (0.66, "kg_day")
    per_kg = content_of(state, "apple", "203") / 100.0 * 2000.0 / MAN["weight_kg"]
    assert protein["mean_usual_intake"] == pytest.approx(per_kg, rel=0.25)
    (carbohydrate,) = asked(client, admin, "CHOCDF")["groups"]  # without fibre
    share = (content_of(state, "apple", "205") - content_of(state, "apple", "291")) / content_of(state, "apple", "203")
    ratio = carbohydrate["mean_usual_intake"] / (protein["mean_usual_intake"] * MAN["weight_kg"])
    assert ratio == pytest.approx(share, rel=0.01)
    for component, reason in (
        ("ENERC_KCAL", "energy_follows_need"),
        ("FIBTG", "no_ear"),
        ("NIA", "intake_is_lower_bound"),  # preformed niacin beside a need of equivalents
    ):
        (men,) = asked(client, admin, component)["groups"]
        assert (men["reason"], men["share_below_ear"], men["persons"]) == (reason, None, 12)


def test_iron_of_menstruating_women_is_not_judged(phone, state, client, admin):
    woman = MAN | {"sex": "female"}
    add_people(state, [[500.0, 600.0]] * 3, woman)
    (women,) = asked(client, admin, "FE")["groups"]
    assert (women["life_stage"], women["reason"]) == ("female_31_50", "need_is_skewed")
    (women,) = asked(client, admin, "VITC")["groups"]
    assert women["reason"] == "too_few_persons"


@pytest.mark.usefixtures("group")
def test_days_with_low_coverage_are_left_out_and_people_without_a_profile_are_counted(state, client, admin):
    owner = phone_owner(state)
    add_meal(state, "M000", FIRST, eaten_item(None), device_of=owner)
    add_meal(state, "M001", FIRST, eaten_item(5000.0), device_of=owner)
    add_meal(state, "M002", FIRST, device_of=owner, status="failed")
    add_meal(state, "M003", FIRST, device_of=owner, status="confirmed")
    add_meal(state, "M004", FIRST, eaten(contents_of(state), 100.0, provisional=True), device_of=owner)
    (men,) = asked(client, admin, "VITC")["groups"]
    assert (men["days"], men["days_left_out"]) == (32, 4)
    add_people(state, [[100.0, 100.0]], None, prefix="X")
    second = str(FIRST + timedelta(days=1))
    body = asked(client, admin, "VITC", **{"from": second, "to": second})
    assert body["persons_without_stage"] == 1
    assert body["groups"][0]["reason"] == "no_repeated_days"


@pytest.mark.usefixtures("phone")
def test_unknown_component_and_reversed_days_are_refused(client, admin):
    reversed_days = {"component": "401", "from": "2026-11-02", "to": "2026-11-01"}
    for params, code in (({"component": "GOLD"}, "component_unknown"), (reversed_days, "days_reversed"), ({}, None)):
        answer = client.get(PATH, headers=admin, params=params)
        assert answer.status_code == 422
        assert code in (None, answer.json()["code"])
