"""Days and mean intakes for researchers: sums with known truth, open days left out, nothing invented."""

import csv
import io
from datetime import UTC, date, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord
from app.nutrition.components import HEADLINE_COLUMNS
from app.people.models import Study
from tests.integration.diary.eaten_days import add_meal, close, eaten_item, set_profile

MAN = {"sex": "male", "birth_year": 1986, "weight_kg": 70.0}  # 40 years: 1676 kcal a day at rest (Schofield)


def rows_of(client, headers, **params):
    return client.get("/v1/days", headers=headers, params=params).json()["items"]


@pytest.fixture
def eaten(phone, state):
    """Four days: one summed from two meals, one with a volume that is not known, one with nothing, one left open."""
    add_meal(
        state,
        "P001",
        "2026-11-01",
        eaten_item(100.0, energy_kcal=50.0, protein_g=2.0, fat_g=1.0),
        eaten_item(300.0, energy_kcal=150.0, protein_g=None, fat_g=2.5, provisional=True),
        eaten_item(500.0, energy_kcal=900.0, status="rejected"),
    )
    add_meal(state, "P001", "2026-11-01", eaten_item(100.0, energy_kcal=-4.0, protein_g=0.5, fat_g=0.0), hour=18)
    add_meal(state, "P001", "2026-11-02", eaten_item(None, status="needs_review"), eaten_item(10.0, energy_kcal=300.0))
    add_meal(state, "P001", "2026-11-05", eaten_item(100.0, energy_kcal=5000.0))
    close(phone, "2026-11-01", "2026-11-02")
    close(phone, "2026-11-03", ate_nothing=True)
    return phone


@pytest.mark.usefixtures("eaten")
def test_sums_have_coverage_and_unknown_values_are_null(client, admin):
    summed, unmeasured, nothing, left_open = rows_of(client, admin)
    assert (summed["meals"], summed["items"], summed["provisional_items"]) == (2, 3, 1)
    assert (summed["consumed_g"], summed["energy_kcal"], summed["fat_g"]) == (500.0, 196.0, 3.5)
    assert (summed["protein_g"], summed["protein_g_coverage"]) == (2.5, pytest.approx(0.4))
    assert (summed["energy_kcal_coverage"], summed["fat_g_coverage"]) == (1.0, 1.0)
    assert (summed["vitamin_c_mg"], summed["vitamin_c_mg_coverage"]) == (None, 0.0)
    assert (unmeasured["unmeasured_items"], unmeasured["energy_kcal"]) == (1, 300.0)
    assert unmeasured["energy_kcal_coverage"] is None
    assert (nothing["day_status"], nothing["ate_nothing"]) == ("closed", True)
    assert (nothing["meals"], nothing["study_day"]) == (0, 3)
    assert [nothing[name] for name in HEADLINE_COLUMNS] == [0.0] * len(HEADLINE_COLUMNS)
    assert [nothing[f"{name}_coverage"] for name in HEADLINE_COLUMNS] == [1.0] * len(HEADLINE_COLUMNS)
    assert (left_open["day_status"], left_open["study_day"], left_open["energy_kcal"]) == ("open", 5, 5000.0)


@pytest.mark.both_stores
@pytest.mark.parametrize(("from_us", "to_us"), [(400, 600), (400, 999_700), (999_700, 400)])
def test_median_delay_is_exact_whichever_database_computes_it(phone, state, client, admin, from_us, to_us):
    add_meal(state, "P001", "2026-11-01", eaten_item(100.0))
    captured_at = datetime(2026, 11, 1, 12, 0, 0, from_us, tzinfo=UTC)
    received_at = captured_at.replace(second=1, microsecond=to_us)
    with state.database.write() as session:
        session.execute(sa.update(Meal).values(captured_at=captured_at, received_at=received_at))
    delay = rows_of(client, admin)[0]["median_upload_delay_seconds"]
    assert delay == (received_at - captured_at).total_seconds()


def test_unmeasured_meal_makes_the_days_coverage_null_and_one_confirmed_without_foods_does_not(
    phone, state, client, admin
):
    set_profile(state, **MAN)
    assert phone.get("/v1/days").json()["items"] == []
    add_meal(state, "P001", "2026-11-01", eaten_item(100.0, energy_kcal=1000.0))
    other = add_meal(state, "P001", "2026-11-01", eaten_item(None, status="rejected"), hour=18, status="confirmed")
    found = intakes(client, admin)[0]
    assert (found["closed_days"], found["open_days"]) == (0, 1)
    assert found["components"]["energy_kcal"] == {"mean": None, "days": 0, "coverage": None}
    close(phone, "2026-11-01")
    day = rows_of(client, admin)[0]
    assert (day["unmeasured_meals"], day["energy_kcal_coverage"], day["plausibility"]) == (0, 1.0, "low")
    for status in ("receiving", "queued", "processing", "failed", "needs_review"):
        with state.database.write() as session:
            session.execute(sa.update(Meal).where(Meal.client_id == other).values(status=status))
        day, mean = rows_of(client, admin)[0], intakes(client, admin)[0]
        assert (day["meals"], day["unmeasured_meals"], day["unmeasured_items"]) == (2, 1, 0), status
        assert (day["energy_kcal"], day["energy_kcal_coverage"], day["plausibility"]) == (1000.0, None, "unknown")
        assert (mean["unmeasured_meals"], mean["components"]["energy_kcal"]["coverage"]) == (1, None)
        assert (mean["plausibility"]["verdict"], mean["plausibility"]["days"]) == ("unknown", 0)


def test_pages_lead_through_all_days_of_all_participants_and_each_sees_its_own(enrol, state, client, admin):
    phones = [enrol(code) for code in ("P001", "P002", "P003")]
    for code, _ in zip(("P001", "P002", "P003"), phones, strict=True):
        for day in (3, 1, 2):
            add_meal(state, code, f"2026-11-0{day}", eaten_item(energy_kcal=10.0), delay=timedelta(minutes=day))
    for minutes in (600, 9):  # the median of two and of three
        add_meal(state, "P001", "2026-11-01", delay=timedelta(minutes=minutes))
        found = rows_of(client, phones[0].headers)[0]["median_upload_delay_seconds"]
        assert found == pytest.approx(60 * {600: 300.5, 9: 9}[minutes], abs=0.01)
    seen, path = [], "/v1/days?limit=2&from=2026-11-01"
    while path:
        page = client.get(path, headers=admin).json()
        assert len(page["items"]) <= 2
        seen += [(row["local_date"], row["participant"]) for row in page["items"]]
        path = page["next"]
    assert len(seen) == len(set(seen)) == 9
    assert [day for day, _ in seen] == sorted(day for day, _ in seen)
    text = client.get("/v1/days?format=csv", headers=admin).text
    assert len(list(csv.DictReader(io.StringIO(text)))) == 9
    assert {row["participant"] for row in rows_of(client, phones[1].headers)} == {"P002"}
    assert client.get("/v1/days?participant=P001", headers=phones[1].headers).status_code == 404


def test_days_energy_is_flagged(phone, state, client, admin):
    add_meal(state, "P001", "2026-11-01", eaten_item(energy_kcal=2500.0))
    set_profile(state, **MAN)
    assert rows_of(client, admin)[0]["plausibility"] == "unknown"  # an open day may lack a meal
    close(phone, "2026-11-01")
    for profile, energy, verdict in (
        (MAN, 1000.0, "low"),
        (MAN, 2500.0, "plausible"),
        (MAN, 5000.0, "high"),
        ({}, 2500.0, "unknown"),
        (MAN, None, "unknown"),
        (MAN | {"birth_year": 2016}, 2500.0, "unknown"),
        (MAN | {"birth_year": 2030}, 2500.0, "unknown"),  # not born on that day
    ):
        set_profile(state, **profile)
        with state.database.write() as session:
            session.execute(sa.update(EffectiveRecord).values(energy_kcal=energy))
        assert rows_of(client, admin)[0]["plausibility"] == verdict, (profile, energy)


def intakes(client, admin, **params):
    return client.get("/v1/studies/pilot/intakes", headers=admin, params=params).json()["items"]


@pytest.mark.usefixtures("eaten")
def test_mean_intake_is_over_closed_days_and_counts_the_open_ones(client, admin):
    found = intakes(client, admin)[0]
    assert (found["closed_days"], found["open_days"], found["silent_days"]) == (3, 1, 1)
    energy, protein = found["components"]["energy_kcal"], found["components"]["protein_g"]
    assert energy == {"mean": pytest.approx((196.0 + 300.0 + 0.0) / 3), "days": 3, "coverage": None}
    assert protein == {"mean": pytest.approx((2.5 + 0.0) / 2), "days": 2, "coverage": None}
    assert (found["unmeasured_items"], found["provisional_items"]) == (1, 1)
    plausibility = found["plausibility"]
    assert (plausibility["verdict"], plausibility["days"]) == ("unknown", 1)  # the day of nothing: one is not final


def test_items_with_unknown_leftovers_are_counted_where_a_pair_is_expected(phone, state, client, admin):
    seen = {"origin": "added"}
    of_declared_meal = add_meal(state, "P001", "2026-11-01", eaten_item(**seen), hour=8)
    add_meal(
        state,
        "P001",
        "2026-11-01",
        eaten_item(**seen),
        eaten_item(**seen, left_g=20.0),
        eaten_item(**seen, left_g=0.0),
        eaten_item(None, **seen),
        eaten_item(**seen | {"status": "rejected"}),
        eaten_item(),  # declared: no camera sees what is left of it
    )
    with state.database.write() as session:
        session.execute(sa.update(Meal).where(Meal.client_id == of_declared_meal).values(origin="declared"))
    add_meal(state, "P001", "2026-11-02", eaten_item(**seen))
    close(phone, "2026-11-01")
    assert [row["leftovers_unknown_items"] for row in rows_of(client, admin)] == [0, 0]
    with state.database.write() as session:
        session.execute(sa.update(Study).values(expects_after_pair=True))
    assert [row["leftovers_unknown_items"] for row in rows_of(client, admin)] == [1, 1]
    text = client.get("/v1/days?format=csv", headers=admin).text
    assert [row["leftovers_unknown_items"] for row in csv.DictReader(io.StringIO(text))] == ["1", "1"]
    assert intakes(client, admin)[0]["leftovers_unknown_items"] == 1  # of closed days


def test_mean_energy_of_whole_days_is_judged_and_a_day_with_a_provisional_record_once_it_is_final(
    phone, state, client, admin
):
    set_profile(state, **MAN)
    for day in range(1, 8):
        add_meal(state, "P001", f"2026-11-0{day}", eaten_item(energy_kcal=1600.0), eaten_item(None, status="rejected"))
        close(phone, f"2026-11-0{day}")
    judged = intakes(client, admin)[0]["plausibility"]
    assert (judged["verdict"], judged["days"]) == ("low", 7)
    assert judged["ratio"] == pytest.approx(1600 / 1676.14, rel=1e-4)
    assert judged["low"] == pytest.approx(1.053, abs=0.001)
    add_meal(state, "P001", "2026-11-02", eaten_item(energy_kcal=600.0, provisional=True), hour=18)
    rows = rows_of(client, admin)  # one day alone tells less
    assert [row["plausibility"] for row in rows] == ["plausible", "unknown", *["plausible"] * 5]
    judged = intakes(client, admin)[0]["plausibility"]
    assert (judged["days"], judged["ratio"]) == (6, pytest.approx(1600 / 1676.14, rel=1e-4))
    with state.database.write() as session:
        session.execute(sa.update(EffectiveRecord).values(provisional=False))
    assert {row["plausibility"] for row in rows_of(client, admin)} == {"plausible"}
    assert intakes(client, admin)[0]["plausibility"]["days"] == 7


def test_intakes_page_by_participant_and_filter_by_day(enrol, state, client, admin):
    for code in ("P003", "P001", "P002"):
        phone = enrol(code)
        add_meal(state, code, "2026-11-01", eaten_item(energy_kcal=100.0))
        add_meal(state, code, "2026-11-02", eaten_item(energy_kcal=300.0))
        close(phone, "2026-11-01", "2026-11-02")
    seen, path = [], "/v1/studies/pilot/intakes?limit=2"
    while path:
        page = client.get(path, headers=admin).json()
        seen += [(row["participant"], row["components"]["energy_kcal"]["mean"]) for row in page["items"]]
        path = page["next"]
    assert seen == [("P001", 200.0), ("P002", 200.0), ("P003", 200.0)]
    assert intakes(client, admin, to="2026-11-01")[0]["components"]["energy_kcal"]["mean"] == 100.0
    assert client.get("/v1/studies/none/intakes", headers=admin).status_code == 404


def test_records_carry_the_days_status_its_number_and_the_delay(phone, state, client, admin):
    add_meal(state, "P001", "2026-11-01", eaten_item(energy_kcal=1.0))
    add_meal(state, "P001", "2026-11-03", eaten_item(energy_kcal=2.0), delay=timedelta(minutes=-2))
    close(phone, "2026-11-03")
    told = ("day_status", "study_day", "upload_delay_seconds")
    expected = [("open", 1, 300.0), ("closed", 3, -120.0)]  # a phone's clock may be ahead
    records = client.get("/v1/records", headers=admin).json()["items"]
    assert [tuple(record[name] for name in told) for record in records] == expected
    rows = csv.DictReader(io.StringIO(client.get("/v1/records?format=csv", headers=admin).text))
    assert [tuple(row[name] for name in told) for row in rows] == [tuple(map(str, row)) for row in expected]
    set_profile(state, starts_on=date(2026, 11, 2))
    records = client.get("/v1/records", headers=admin).json()["items"]
    assert [record["study_day"] for record in records] == [0, 2]


def test_closed_day_of_meals_that_were_confirmed_without_food_is_a_day_of_nothing(phone, state, client, admin):
    set_profile(state, **MAN)
    add_meal(state, "P001", "2026-11-01", eaten_item(None, status="rejected"), status="confirmed")
    add_meal(state, "P001", "2026-11-02", status="confirmed")
    add_meal(state, "P001", "2026-11-03", eaten_item(energy_kcal=3000.0))
    add_meal(state, "P001", "2026-11-05", eaten_item(-2.0, energy_kcal=-1.0, protein_g=None))  # all of it was left
    assert rows_of(client, admin)[0]["energy_kcal"] is None  # an open day may lack a meal
    close(phone, "2026-11-01", "2026-11-02", "2026-11-03")
    rejected, empty, _, untouched = rows_of(client, admin)
    assert (untouched["energy_kcal"], untouched["energy_kcal_coverage"]) == (-1.0, 1.0)
    assert (untouched["protein_g"], untouched["protein_g_coverage"]) == (None, 0.0)
    for day in (rejected, empty):
        assert (day["energy_kcal"], day["energy_kcal_coverage"], day["consumed_g"]) == (0.0, 1.0, 0.0)
        assert (day["ate_nothing"], day["plausibility"]) == (False, "low")  # ate_nothing is a word of its own
    mean = intakes(client, admin)[0]
    assert mean["components"]["energy_kcal"] == {"mean": pytest.approx(1000.0), "days": 3, "coverage": 1.0}
    assert mean["plausibility"]["days"] == 3
    close(phone, "2026-11-05")
    assert intakes(client, admin)[0]["plausibility"]["days"] == 4  # a day of nothing eaten is whole
    close(phone, "2026-11-04")
    no_meal = rows_of(client, admin)[3]
    assert (no_meal["day_status"], no_meal["ate_nothing"]) == ("closed", False)
    assert (no_meal["energy_kcal"], no_meal["consumed_g"]) == (None, None)
