"""A participant's feedback: off by default; a day's amounts; from three whole days on beside reference intakes."""

import pytest
import sqlalchemy as sa

from app.people.models import Study
from tests.integration.diary.eaten_days import add_meal, close, eaten_item, set_profile
from tests.integration.meals.upload.answers import refusal

PATH = "/v1/me/summary"
WOMAN = {"sex": "female", "birth_year": 1990, "weight_kg": 60.0}
EATEN = {
    "energy_kcal": 2000.0,
    "protein_g": 70.0,
    "fibre_g": 20.0,
    "sodium_mg": 3100.0,
    "potassium_mg": 2000.0,
    "vitamin_c_mg": 40.0,
}


@pytest.fixture
def feedback(phone, state):
    """A phone of a study that gives feedback."""
    with state.database.write() as session:
        session.execute(sa.update(Study).values(gives_feedback=True))
    return phone


def eat(state, phone, *days, closed=True, **columns):
    for day in days:
        add_meal(state, "P001", f"2026-11-{day:02}", eaten_item(100.0, **(EATEN | columns)))
        if closed:
            close(phone, f"2026-11-{day:02}")


def test_feedback_is_off_unless_the_study_gives_it(phone, state, client, admin):
    add_meal(state, "P001", "2026-11-19", eaten_item(energy_kcal=80.0))
    assert refusal(phone.get(PATH)) == (403, "feedback_off")
    staff = "/v1/studies/pilot/participants/P001/summary"
    assert client.get(staff, headers=admin).json()["components"]["energy_kcal"]["amount"] == 80.0
    assert client.get(staff.replace("P001", "P999"), headers=admin).status_code == 404


def test_day_shows_amounts_by_meal_and_compares_nothing(feedback, state):
    first = add_meal(state, "P001", "2026-11-19", eaten_item(100.0, energy_kcal=80.0, fat_g=0.0), hour=8)
    fat = feedback.get(PATH, date="2026-11-19").json()["components"]["fat_g"]
    assert fat == {"amount": 0.0, "interval": None, "coverage": 1.0}  # no fat, says the table
    eaten = eaten_item(200.0, energy_kcal=300.0, fat_g=8.0), eaten_item(None)
    add_meal(state, "P001", "2026-11-19", *eaten, hour=19)
    body = feedback.get(PATH, date="2026-11-19").json()
    energy = body["components"]["energy_kcal"]
    assert (energy["amount"], energy["coverage"]) == (380.0, None)
    assert energy["interval"] == [pytest.approx(0.9 * 380), pytest.approx(1.1 * 380)]
    assert body["components"]["fat_g"]["interval"] == [pytest.approx(0.9 * 8.0), pytest.approx(1.1 * 8.0)]
    assert [meal["components"]["energy_kcal"]["amount"] for meal in body["meals"]] == [80.0, 300.0]
    assert (body["meals"][0]["meal_id"], body["meals"][1]["unmeasured_items"]) == (str(first), 1)
    assert (body["unmeasured_items"], body["status"], body["study_day"]) == (1, "open", 1)
    assert body["components"]["vitamin_c_mg"] == {"amount": None, "interval": None, "coverage": None}
    assert (body["comparison"]["why_not"], body["comparison"]["components"]) == ("days_needed", {})
    assert "Meals on 2026-11-19: 2." in body["sentences"][0]
    assert "not medical advice" in body["disclaimer"]


def test_summary_without_a_date_is_of_the_last_day_and_compares_days_of_its_window(feedback, state):
    assert feedback.get(PATH).json()["code"] == "no_day_yet"
    eat(state, feedback, 1, 2, 3, 20)
    body = feedback.get(PATH).json()
    assert body["date"] == "2026-11-20"
    assert feedback.get(PATH, date="2026-11-05").json()["meals"] == []
    for day, closed in ((16, 1), (14, 3)):
        assert feedback.get(PATH, date=f"2026-11-{day}").json()["comparison"]["closed_days"] == closed
    for profile in ({}, {"birth_year": 1990}):  # without age and sex nothing is compared
        set_profile(state, **profile)
        assert feedback.get(PATH, date="2026-11-14").json()["comparison"]["why_not"] == "profile_needed"


def test_comparison_needs_three_closed_days_that_are_measured_whole(feedback, state):
    set_profile(state, **WOMAN)
    eat(state, feedback, 15, 16)
    eat(state, feedback, 17, closed=False)
    add_meal(state, "P001", "2026-11-18", eaten_item(None))
    close(feedback, "2026-11-18")
    compared = feedback.get(PATH).json()["comparison"]
    assert (compared["closed_days"], compared["whole_days"], compared["why_not"]) == (3, 2, "days_needed")
    eat(state, feedback, 14)
    body = feedback.get(PATH).json()
    compared = body["comparison"]
    assert (compared["closed_days"], compared["whole_days"], compared["why_not"]) == (4, 3, None)
    verdicts = {name: found["verdict"] for name, found in compared["components"].items()}
    assert verdicts == {
        "protein_g": "reaches",  # 46 g a day
        "fibre_g": "open_adequate",  # 25 g, an AI
        "sodium_mg": "above_limit",  # 2300 mg, the CDRR
        "potassium_mg": "open_adequate",
        "vitamin_c_mg": "below",  # 75 mg
    }
    assert any("rests on 4 closed days of the last 14" in sentence for sentence in body["sentences"])
    assert any("could not be measured or is not final yet: 1" in sentence for sentence in body["sentences"])
    assert any(sentence.startswith("Days differ") for sentence in body["sentences"])


def test_partly_known_contents_never_give_the_verdict_below_and_days_with_a_failed_meal_none(feedback, state):
    set_profile(state, **WOMAN)
    eat(state, feedback, 15, 16, 17)
    add_meal(state, "P001", "2026-11-16", eaten_item(50.0, energy_kcal=10.0))
    close(feedback, "2026-11-16")
    found = feedback.get(PATH).json()["comparison"]["components"]
    assert found["vitamin_c_mg"]["verdict"] == "open_coverage"
    assert found["vitamin_c_mg"]["coverage"] == pytest.approx((1 + 100 / 150 + 1) / 3)
    assert found["protein_g"]["verdict"] == "reaches"
    add_meal(state, "P001", "2026-11-17", hour=19, status="failed")
    body = feedback.get(PATH).json()
    energy = body["components"]["energy_kcal"]
    assert (body["unmeasured_meals"], energy["amount"], energy["coverage"]) == (1, 2000.0, None)
    assert "Meals that were not measured, and are missing from these figures: 1." in body["sentences"]
    compared = body["comparison"]
    assert (compared["closed_days"], compared["whole_days"], compared["why_not"]) == (3, 2, "days_needed")


def test_day_with_a_provisional_record_is_left_out_of_the_comparison(feedback, state):
    set_profile(state, **WOMAN)
    eat(state, feedback, 14, 15, 16)
    eat(state, feedback, 17, provisional=True)
    body = feedback.get(PATH).json()
    assert body["provisional_items"] == 1
    compared = body["comparison"]
    assert (compared["closed_days"], compared["whole_days"]) == (4, 3)
    assert {each["days"] for each in compared["components"].values()} == {3}
    left_out = "Of these, days left out because something could not be measured or is not final yet: 1."
    assert left_out in body["sentences"]


def test_day_with_nothing_eaten_has_zeros_and_a_sentence(feedback):
    body = {"status": "closed", "ate_nothing": True}
    feedback.put("/v1/me/days/2026-11-19", json=body, headers={"If-Match": '"0"'})
    found = feedback.get(PATH).json()
    assert (found["ate_nothing"], found["components"]["energy_kcal"]["amount"]) == (True, 0.0)
    assert found["sentences"][0] == "You told us that you ate nothing on 2026-11-19."


@pytest.mark.parametrize(
    ("locale", "advice", "energy", "interval"),
    [
        ("de", "kein ärztlicher Rat", "etwa 2000 kcal.", "zwischen 1800 und 2200 kcal."),
        ("es", "no un consejo médico", "unas 2000 kcal.", "entre 1800 y 2200 kcal."),
        ("zh", "不是医疗建议", "8400 千焦（2000 千卡）", "7500 到 9200 千焦（1800 到 2200 千卡）"),
    ],
)
def test_sentences_are_in_the_studys_language_and_energy_in_the_units_of_its_food_labels(
    feedback, state, locale, advice, energy, interval
):
    with state.database.write() as session:
        session.execute(sa.update(Study).values(locale=locale))
    set_profile(state, **WOMAN)
    eat(state, feedback, 15, 16, 17)
    body = feedback.get(PATH).json()
    assert body["locale"] == locale
    assert advice in body["disclaimer"]
    assert (energy in body["sentences"][0], interval in body["sentences"][1]) == (True, True), body["sentences"][:2]
    assert len(body["sentences"]) == 9  # the day, its interval, the basis, five nutrients, the doubt
