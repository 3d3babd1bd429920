"""Records as FHIR resources: valid by a FHIR library, with the figures of the rest of the API."""

import uuid

import pytest
import sqlalchemy as sa

from app.foods.models import Food
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord
from tests.integration.diary.eaten_days import add_meal, eaten_item
from tests.integration.records.after_pairs import Table, apple, banana, left_of_apple
from tests.integration.records.eating import eaten
from tests.integration.records.reviewing import Speaker
from tests.support.estimates import found_item, unmeasured_item
from tests.support.fhir_models import TAGNAMES, bundle, error_of, labels, valid

ABSENT = "http://hl7.org/fhir/StructureDefinition/data-absent-reason"
BASE = "http://testserver/fhir"


def records_of(phone):
    rows = phone.get("/v1/records", limit=1000).json()["items"]
    return {row["id"]: row for row in rows if row["status"] != "rejected"}


def intakes_of(phone, **params):
    return {resource["id"]: resource for resource in bundle(phone.get("/fhir/NutritionIntake", **params))}


@pytest.fixture
def diary(phone, state, client, admin):
    """Meals with what was left, without a volume, without a food, declared, shared, rejected and corrected."""
    Table(phone, state, seed=1, captured_at="2026-11-17T12:30:00+08:00").ate(left_of_apple(60.0))
    corrected = Table(phone, state, seed=2, captured_at="2026-11-18T08:00:00+08:00").measured(apple(), banana())
    eaten(phone, state, unmeasured_item(), found_item(hint=None), seed=3, captured_at="2026-11-19T23:50:00-05:00",
          time_zone="America/New_York")  # fmt: skip
    speaker = Speaker(client, admin, corrected.id)
    first, second = (item["id"] for item in speaker.items())
    speaker.say("set_food", item=first, food="pear")
    speaker.say("set_share", item=first, share=0.5)
    speaker.say("reject", item=second)
    body = {"id": str(uuid.uuid4()), "captured_at": "2026-11-18T16:00:00+08:00", "time_zone": "Asia/Shanghai",
            "items": [{"food": "milk-whole", "amount": {"volume_ml": 250}}]}  # fmt: skip
    assert client.post("/v1/declared-meals", headers=phone.headers, json=body).status_code == 201
    return phone


def test_figures_of_intakes_are_those_of_the_records(diary):
    records, intakes = records_of(diary), intakes_of(diary)
    assert set(intakes) == set(records)
    assert len(records) == 6
    for key, record in records.items():
        intake = valid(diary.get(f"/fhir/NutritionIntake/{key}"))
        assert intake == intakes[key]
        amount, nutrients = intake["consumedItem"][0]["amount"], labels(intake)
        assert amount.get("value") == record["consumed_g"]
        if record["consumed_g"] is not None:
            (interval,) = amount["extension"]
            ends = (interval["valueRange"]["low"]["value"], interval["valueRange"]["high"]["value"])
            assert interval["url"] == f"{BASE}/StructureDefinition/interval-90"
            assert ends == (record["consumed_low_g"], record["consumed_high_g"])
        for column, tagname in TAGNAMES.items():
            assert nutrients.get(tagname, (None,))[0] == record[column], column
        status = next(each for each in intake["extension"] if each["url"].endswith("record-status"))
        assert status["valueCode"] == record["status"]


def test_every_component_that_the_meal_tells_is_a_label_with_its_unit(diary):
    ucum, compared = {"IU": "[iU]"}, 0
    records, intakes = records_of(diary), intakes_of(diary)
    for meal_id in {record["meal_id"] for record in records.values()}:
        for item in diary.get(f"/v1/meals/{meal_id}").json()["items"]:
            if item["status"] == "rejected":
                continue
            told = {row["number"]: (row["amount"], ucum.get(row["unit"], row["unit"])) for row in item["nutrients"]}
            found = labels(intakes[item["id"]])
            assert len(intakes[item["id"]].get("ingredientLabel", ())) == len(told)
            for number, (amount, unit) in told.items():
                assert found[number] == (pytest.approx(amount, rel=1e-12), unit)
                compared += 1
    assert compared > 100


def test_an_amount_that_is_not_known_says_so_and_has_no_nutrients(diary):
    unknown = [intakes for key, intakes in intakes_of(diary).items() if records_of(diary)[key]["consumed_g"] is None]
    assert len(unknown) == 2
    for intake in unknown:
        item = intake["consumedItem"][0]
        assert item["amount"] == {"extension": [{"url": ABSENT, "valueCode": "unknown"}]}
        assert "ingredientLabel" not in intake
        assert any("missing" in note["text"] for note in intake["note"])
    foods = [intake["consumedItem"][0]["nutritionProduct"]["concept"] for intake in unknown]
    assert {food["coding"][0]["code"] for food in foods} == {"apple", "unknown"}


def test_unknown_component_is_absent_and_zero_and_negative_amounts_are_told_under_the_public_url(phone, state, client):
    add_meal(state, "P001", "2026-11-01", eaten_item(-2.5, energy_kcal=0.0, protein_g=None))
    client.app.state.settings = client.app.state.settings.model_copy(update={"public_url": "https://tada.example.org/"})
    answer = phone.get("/fhir/NutritionIntake")
    (intake,) = bundle(answer)
    assert labels(intake)["ENERC_KCAL"] == (0.0, "kcal")
    assert "PROCNT" not in labels(intake)
    assert intake["consumedItem"][0]["amount"]["value"] == -2.5
    assert "bias" in intake["note"][0]["text"]
    assert intake["identifier"][0]["system"] == "https://tada.example.org/fhir/sid/items"
    assert answer.json()["link"][0]["url"] == "https://tada.example.org/fhir/NutritionIntake"


def test_who_when_and_by_whom(diary):
    records, intakes = records_of(diary), intakes_of(diary)
    people = f"{BASE}/sid/studies/pilot/participants"
    for key, intake in intakes.items():
        record, meal = records[key], diary.get(f"/v1/meals/{records[key]['meal_id']}").json()
        assert intake["subject"]["identifier"] == {"system": people, "value": "P001"}
        meals = {"system": f"{people}/P001/meals", "value": record["meal_id"]}
        assert intake["partOf"][0]["identifier"] == meals
        assert intake["occurrenceDateTime"][:10] == record["local_date"]
        assert intake["_occurrenceDateTime"]["extension"][0]["valueCode"] == record["time_zone"]
        assert intake["recorded"][:19] == meal["received_at"][:19]
        assert intake["meta"] == {"versionId": str(record["change_seq"])}
        if record["origin"] == "declared":
            assert intake["reportedReference"] == intake["subject"]
        else:
            assert intake["reportedBoolean"] is False
    times = {intake["occurrenceDateTime"] for intake in intakes.values()}
    assert {"2026-11-17T12:30:00+08:00", "2026-11-19T23:50:00-05:00"} <= times
    (subject,) = {intake["subject"]["reference"] for intake in intakes.values()}
    patient = {"resourceType": "Patient", "id": "pilot.P001", "identifier": [{"system": people, "value": "P001"}]}
    assert valid(diary.get(f"/fhir/{subject}")) == patient | {"active": True}


def test_a_rejected_record_is_in_no_search_and_gone_by_its_id(diary):
    rejected = [row["id"] for row in diary.get("/v1/records", status="rejected").json()["items"]]
    assert len(rejected) == 1
    assert error_of(diary.get(f"/fhir/NutritionIntake/{rejected[0]}")) == (410, "record_rejected")
    assert intakes_of(diary, _id=rejected[0]) == {}


def test_flags_are_notes_and_the_source_tables_codes_stand_beside_ours(phone, state):
    food = "apple-of-tables"
    with state.database.write() as session:
        apple_row = session.scalars(sa.select(Food).where(Food.key == "apple")).first()
        ids = {"fdc_id": "1750340", "sr28_ndb": "09003", "sr28_name": "APPLES,RAW", "label": "x"}
        session.add(Food(release_id=apple_row.release_id, key=food, version=2, name=" Apple,  two  spaces ", aliases=[],
                         food_group="", form="whole", refuse=[], probes=[], source_ids=ids))  # fmt: skip
    add_meal(state, "P001", "2026-11-01", eaten_item(100.0, food=food))
    with state.database.write() as session:
        session.execute(sa.update(EffectiveRecord).values(flags=["low_texture"]))
    (intake,) = intakes_of(phone).values()
    assert [note["text"] for note in intake["note"]] == ["Flag: low_texture"]
    concept = intake["consumedItem"][0]["nutritionProduct"]["concept"]
    assert concept["text"] == "Apple, two spaces"
    assert concept["coding"][0]["version"].endswith(", version 2")
    assert {(each["system"], each["code"]) for each in concept["coding"]} == {
        (f"{BASE}/sid/foods", food),
        ("https://fdc.nal.usda.gov/", "1750340"),
        (f"{BASE}/sid/usda-ndb", "09003"),
    }


def test_an_intake_is_in_progress_as_long_as_a_pair_after_the_meal_may_come(enrol, state):
    phone = enrol(expects_after_pair=True)
    table = Table(phone, state).measured()
    waiting = intakes_of(phone)
    assert len(waiting) == 2
    for key, intake in waiting.items():
        assert (intake["status"], records_of(phone)[key]["provisional"]) == ("in-progress", True)
    assert intakes_of(phone, status="in-progress") == waiting
    assert intakes_of(phone, status="completed") == {}
    table.send_after().after_measured(left_of_apple(40.0))
    done = intakes_of(phone)
    assert {intake["status"] for intake in done.values()} == {"completed"}
    assert intakes_of(phone, status="http://hl7.org/fhir/event-status|completed") == done
    assert intakes_of(phone, status="in-progress") == {}


def test_what_a_person_adds_is_reported_and_a_change_of_a_record_is_a_new_version(phone, state, client, admin):
    speaker = Speaker(client, admin, eaten(phone, state))
    (before,) = intakes_of(phone).values()
    tag = phone.get(f"/fhir/NutritionIntake/{before['id']}").headers["etag"]
    assert tag == f'W/"{before["meta"]["versionId"]}"'
    speaker.say("add", food="pear", amount={"mass_g": 80.0}, share=1.0)
    speaker.say("confirm", item=before["id"])
    after = intakes_of(phone)
    assert int(after[before["id"]]["meta"]["versionId"]) > int(before["meta"]["versionId"])
    added = next(each for each in after.values() if each["reportedBoolean"])
    record = records_of(phone)[added["id"]]
    reviewed = next(each for each in added["extension"] if each["url"].endswith("reviewed"))
    assert (record["origin"], reviewed["valueBoolean"]) == ("added", record["reviewed"])


def test_what_the_server_says_of_itself_is_valid_and_needs_no_token(client):
    statement = valid(client.get("/fhir/metadata"))
    assert (statement["fhirVersion"], statement["kind"]) == ("5.0.0", "instance")
    told = {resource["type"]: resource for resource in statement["rest"][0]["resource"]}
    assert {each["name"] for each in told["NutritionIntake"]["searchParam"]} >= {"subject", "patient", "date", "status"}


def test_the_definition_of_every_extension_of_ours_can_be_read(diary, client):
    urls = set()

    def collect(value):
        if isinstance(value, dict):
            urls.update(each["url"] for each in value.get("extension", ()))
            value = list(value.values())
        if isinstance(value, list):
            for each in value:
                collect(each)

    collect(list(intakes_of(diary).values()))
    own = {url for url in urls if url.startswith(BASE)}
    assert len(own) == 3
    for url in own:
        definition = valid(client.get(url.removeprefix("http://testserver")))
        assert definition["url"] == url
    assert error_of(client.get("/fhir/StructureDefinition/none")) == (404, "not_found")


def test_an_anonymised_participant_is_another_patient(diary, client, admin, state):
    key = next(iter(intakes_of(diary)))
    client.patch("/v1/studies/pilot", headers=admin | {"If-Match": "*"}, json={"withdrawal_policy": "anonymise"})
    left = client.post("/v1/studies/pilot/participants/P001/withdrawal", headers=admin)
    assert left.status_code in (200, 201), left.text
    assert error_of(client.get("/fhir/Patient/pilot.P001", headers=admin)) == (404, "not_found")
    subject = valid(client.get(f"/fhir/NutritionIntake/{key}", headers=admin))["subject"]
    assert subject["reference"].startswith("Patient/pilot.withdrawn-")
    assert valid(client.get(f"/fhir/{subject['reference']}", headers=admin))["active"] is False
    with state.database.read() as session:
        assert session.query(Meal).count() == 4
