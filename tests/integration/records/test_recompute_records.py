"""Figures or densities of a food change: records follow when asked, in their study, and nothing else changes."""

import dataclasses
import uuid
from datetime import UTC, date, datetime

import pytest
import sqlalchemy as sa

from app.core.units import Unit
from app.foods import queries as foods
from app.foods.component_names import Figure
from app.foods.edits import edit_food
from app.foods.edits.edit_food import Editor, FoodEdit
from app.foods.food_releases import use_release
from app.foods.food_values import food_value
from app.foods.import_foods import write_food
from app.foods.models import FoodActivation, FoodRelease
from app.foods.study_densities import Measurement, add_study_density, withdraw_study_density
from app.meals.stored.event_models import MealEvent
from app.meals.stored.models import Meal
from app.meals.stored.record_models import Item, ItemFood, Recompute
from app.nutrition.foods import Density
from app.records.project_records import project_meal
from app.records.recompute_records import rebuild_records, recompute_nutrients
from tests.integration.records.eating import APPLE_HINT, eaten
from tests.support.estimates import found_item, unmeasured_item


@pytest.fixture
def meal_id(phone, state):
    """Two apples, one of them without a volume."""
    return eaten(phone, state, found_item(hint=0), unmeasured_item(hint=1), hints=APPLE_HINT * 2)


def correct_apple(state, **changes):
    """A local version of the apple with other figures, as an edit makes it."""
    now = datetime.now(UTC)
    with state.database.write() as session:
        apple = foods.foods_by_key(session, ["apple"])["apple"]
        value = dataclasses.replace(food_value(session, apple), **changes)
        names = {"source": "local", "name": "local", "version": "1", "checksum": "l" * 64}
        release = FoodRelease(released_on=date(2026, 11, 21), imported_at=now, completed_at=now, **names)
        session.add(release)
        session.flush()
        session.add(FoodActivation(name="local", release_id=release.id, author="me", activated_at=now))
        write_food(session, release, value)


def recompute(state, **changes):
    told = []
    arguments = {"write": True, "author": "me", "reason": "a test", "tell": told.append} | changes
    return recompute_nutrients(state.database, **arguments), told


def record_of(phone):
    found = phone.get("/v1/records").json()["items"]
    return sorted(found, key=lambda one: one["volume_ml"] is None)


@pytest.mark.usefixtures("meal_id")
def test_dry_run_tells_the_difference_and_changes_nothing_nor_does_a_run_without_one(phone, state):
    before = record_of(phone)
    done, told = recompute(state)
    assert (done.compared, done.changed, told) == (2, 0, [])
    correct_apple(state, per_100_g={"208": 104.0, "401": 4.6})
    done, told = recompute(state, write=False)
    assert done.changed == 2
    measured = next(found for found in told if found.columns)
    energy_before, energy_after = measured.columns["energy_kcal"]
    assert energy_after == pytest.approx(2 * energy_before)
    assert measured.columns["carbohydrate_g"][1] is None  # no longer known, and not 0
    assert "mass_g" not in measured.columns
    assert record_of(phone) == before
    with state.database.read() as session:
        assert session.scalars(sa.select(Recompute)).all() == []


@pytest.mark.usefixtures("meal_id")
def test_records_are_made_anew_and_the_old_ones_stay(phone, state):
    def items():
        with state.database.read() as session:
            rows = session.scalars(sa.select(Item).order_by(Item.id))
            return [(item.id, item.volume_ml, item.rings, item.flags) for item in rows]

    before, items_before = record_of(phone), items()
    correct_apple(state, per_100_g={"208": 104.0})
    done, _ = recompute(state)
    after = record_of(phone)
    assert items() == items_before
    assert done.changed == 2
    assert [one["volume_ml"] for one in after] == [one["volume_ml"] for one in before]
    assert after[0]["energy_kcal"] == pytest.approx(2 * before[0]["energy_kcal"])
    assert after[0]["food_table"] == "local 1"
    assert min(one["change_seq"] for one in after) > max(one["change_seq"] for one in before)
    with state.database.read() as session:
        versions = session.execute(sa.select(ItemFood.version, ItemFood.recompute_id).order_by(ItemFood.version)).all()
        history = session.scalars(sa.select(Recompute)).one()
    assert [version for version, _ in versions] == [1, 1, 2, 2]
    assert {recompute_id for _, recompute_id in versions} == {None, history.id}
    assert (history.author, history.reason) == ("me", "a test")
    assert history.food_releases[0] == "local 1"
    assert recompute(state)[0].changed == 0
    assert rebuild_records(state.database, write=False).different == 0


@pytest.mark.parametrize(
    ("kinds", "measured", "unmeasured"),
    [
        (["confirm"], "confirmed", "needs_review"),  # how much of it was eaten is still not known
        (["set_mass"], "corrected", "corrected"),
        (["set_mass", "reject"], "rejected", "rejected"),
    ],
)
def test_word_of_a_person_survives(phone, state, meal_id, kinds, measured, unmeasured):
    say(state, meal_id, kinds)
    correct_apple(state, per_100_g={"208": 104.0})
    done, _ = recompute(state)
    assert done.changed == (0 if "reject" in kinds else 2)
    assert [one["status"] for one in record_of(phone)] == [measured, unmeasured]
    assert rebuild_records(state.database, write=False).different == 0


def say(state, meal_client_id, kinds):
    """A participant's events about both items."""
    with state.database.write() as session:
        meal = session.scalars(sa.select(Meal).where(Meal.client_id == uuid.UUID(meal_client_id))).one()
        items = session.scalars(sa.select(Item).order_by(Item.position)).all()
        events = [(kind, item.id) for kind in kinds for item in items]
        common = {"meal_id": meal.id, "layer": "participant", "request_sha256": "", "created_at": datetime.now(UTC)}
        mass = {"mass_g": 120.0, "of": "as_seen", "relative_sd": 0.1}
        for number, (kind, item_id) in enumerate(events, 1):
            told = {"kind": kind, "old": {}, "new": mass if kind == "set_mass" else {}}
            session.add(MealEvent(id=uuid.uuid4(), sequence=number, item_id=item_id, **told, **common))
        project_meal(session, meal)


@pytest.mark.usefixtures("meal_id")
def test_food_that_no_table_has_any_more_is_left_as_it_is_and_counted(phone, state):
    before = record_of(phone)
    use_release(state.database, "tada-starter", None, "me")
    done, told = recompute(state)
    assert (done.changed, told, dict(done.gone)) == (0, [], {"apple": 2})
    assert record_of(phone) == before


@pytest.mark.usefixtures("meal_id")
def test_only_the_named_study_is_computed_anew(phone, state, enrol):
    other = enrol("P002", study="other")
    meal_id = eaten(other, state, seed=1)
    correct_apple(state, per_100_g={"208": 104.0})
    done, told = recompute(state, study_code="other")
    assert (done.compared, done.changed) == (1, 1)
    assert str(told[0].meal_id) == meal_id
    assert {one["food_table"] for one in record_of(phone)} != {"local 1"}


EDITOR = Editor("a test", "to see")


def test_a_correction_reaches_records_and_its_undoing_too(phone, state):
    eaten(phone, state)
    before = record_of(phone)[0]
    energy = FoodEdit(nutrients={"ENERC_KCAL": Figure(104.0, Unit.KCAL)})
    edit_food.edit_food(state.database, "apple", energy, EDITOR)
    assert record_of(phone)[0] == before
    recompute(state)
    assert record_of(phone)[0]["energy_kcal"] == pytest.approx(2 * before["energy_kcal"])
    edit_food.restore_food(state.database, "apple", 1, EDITOR)
    recompute(state)
    assert record_of(phone)[0]["energy_kcal"] == pytest.approx(before["energy_kcal"])


def test_a_study_s_density_reaches_its_own_records_only(enrol, state):
    ours, theirs = enrol("P001", "pilot"), enrol("P002", "second")
    for phone in (ours, theirs):
        eaten(phone, state)
    before, others = record_of(ours)[0], record_of(theirs)[0]
    half = before["mass_g"] / before["volume_ml"] / 2
    measured = Measurement("apple", Density(half, 0.01, "raw", "solid", "study", "scale"))
    row = add_study_density(state.database, "pilot", measured, EDITOR)
    recompute(state)
    assert record_of(ours)[0]["mass_g"] == pytest.approx(before["mass_g"] / 2)
    assert record_of(theirs)[0] == others
    withdraw_study_density(state.database, "pilot", row.id, EDITOR)
    recompute(state)
    assert record_of(ours)[0]["mass_g"] == pytest.approx(before["mass_g"])
