"""The tables over HTTP: formats, GeoJSON, data dictionary, permissions, refusals, audit log."""

import csv
import io
import json
from datetime import UTC, date, datetime

import pytest
import sqlalchemy as sa
from pyarrow import parquet

from app.exports.export_spec import WITHOUT_COMPONENTS, ExportSpec, spec_as_json, spec_of_json
from app.foods.models import Component, Food, FoodNutrient
from app.http.columns import meal_columns, record_columns
from app.http.row_filter import RowFilter
from app.meals.stored.event_models import LAYERS
from app.meals.stored.models import AFTER_STATUSES, MEAL_ORIGINS, MEAL_STATUSES, Meal
from app.meals.stored.record_models import ITEM_ORIGINS, RECORD_STATUSES, EffectiveRecord
from app.people.models import Device, Participant, Study
from app.people.privacy_models import AuditEvent
from tests.integration.conftest import meal_metadata
from tests.integration.diary.eaten_days import add_meal, eaten_item
from tests.integration.meals.upload.answers import refusal
from tests.support.photographs import pair

TABLES = {
    "items": "/v1/records",
    "meals": "/v1/meals",
    "days": "/v1/days",
    "photographs": "/v1/studies/pilot/photographs",
    "participants": "/v1/studies/pilot/participants",
}
COMBINATIONS = [
    (rows, layout, components)
    for rows in ("items", "meals", "days")
    for layout in ("wide", "long")
    for components in ("headline", "all")
] + [("photographs", "wide", "headline"), ("participants", "wide", "headline")]
PLACE = {"latitude": 48.1371, "longitude": 11.5754, "accuracy_m": 5.0}


@pytest.fixture
def settings(settings):
    return settings.model_copy(update={"exports_per_minute": 0})  # a test asks for more than a person does


@pytest.fixture
def study(enrol, state):
    """Two participants, one of a code that a spreadsheet would compute, who ate and sent photographs."""
    enrol("P002")
    phone = enrol("P001", location_policy="keep")
    with state.database.write() as session:
        session.execute(sa.update(Study).values(location_policy="keep"))
    assert phone.post(pair(), meal_metadata(location=PLACE)).status_code == 202
    add_meal(state, "P002", "2026-11-02", eaten_item(200.0, "apple", energy_kcal=104.0), eaten_item(None))
    with state.database.write() as session:
        session.execute(sa.update(Participant).where(Participant.code == "P002").values(code="=1+2"))
    return phone


def read_csv(client, headers, path, **params):
    answer = client.get(path, headers=headers, params=params | {"format": "csv"})
    assert answer.status_code == 200, answer.text
    return list(csv.DictReader(io.StringIO(answer.text, newline="")))


def read_ndjson(client, headers, path, **params):
    answer = client.get(path, headers=headers, params=params | {"format": "ndjson"})
    assert answer.status_code == 200, answer.text
    return [json.loads(line) for line in answer.content.splitlines()]


def asked(rows, layout, components):
    return {} if rows in WITHOUT_COMPONENTS else {"layout": layout, "components": components}


def test_dictionary_tells_every_column_of_every_table_and_its_key_tells_rows_apart(study, client, admin):
    for rows, layout, components in COMBINATIONS:
        params = {"rows": rows, "layout": layout, "components": components}
        of_table = asked(rows, layout, components)
        told = client.get("/v1/data-dictionary", headers=admin, params=params).json()
        text = client.get(TABLES[rows], headers=admin, params=of_table | {"format": "csv"}).text
        names = [column["name"] for column in told["columns"]]
        assert ",".join(names) == text.splitlines()[0]
        for column in told["columns"]:
            assert column["meaning"].endswith("."), column
            assert column["empty"] is None or column["empty"].endswith("."), column
        as_csv = read_csv(client, admin, "/v1/data-dictionary", **params)
        assert [(row["name"], row["unit"], row["meaning"]) for row in as_csv] == [
            (column["name"], column["unit"] or "", column["meaning"]) for column in told["columns"]
        ]
        schema = client.get("/v1/data-dictionary", headers=admin, params=params | {"format": "table-schema"}).json()
        assert [field["name"] for field in schema["fields"]] == names
        assert schema["primaryKey"] == told["key"]
        found = read_ndjson(client, admin, TABLES[rows], **of_table)
        assert found
        assert len({tuple(row[name] for name in told["key"]) for row in found}) == len(found)
        cells = [cell for row in csv.reader(io.StringIO(text, newline="")) for cell in row]
        assert not [cell for cell in cells if cell.startswith(("=", "+", "@", "\t", "\r"))]  # none is a formula
        assert rows == "photographs" or "'=1+2" in cells


def test_values_that_the_dictionary_lists_are_those_of_the_models():
    assert record_columns.RECORD_STATUSES == RECORD_STATUSES
    assert record_columns.ORIGINS == ITEM_ORIGINS
    assert record_columns.LAYERS == LAYERS
    assert meal_columns.MEAL_STATUSES == MEAL_STATUSES
    assert meal_columns.MEAL_ORIGINS == MEAL_ORIGINS
    assert meal_columns.AFTER_STATUSES == AFTER_STATUSES


def test_components_of_the_foods_in_use_are_columns_and_unknown_ones_are_empty(study, client, admin, state):
    with state.database.read() as session:
        known = session.execute(
            sa.select(Component.tagname, FoodNutrient.per_100_g)
            .join(FoodNutrient, FoodNutrient.component_id == Component.id)
            .join(Food, Food.id == FoodNutrient.food_id)
            .where(Food.key == "apple", Component.tagname.is_not(None))
        ).all()
    apple, unknown = read_ndjson(client, admin, "/v1/records", components="all", participant="=1+2")[::1]
    apple, unknown = (apple, unknown) if apple["food_key"] == "apple" else (unknown, apple)
    by_tagname = {name.rpartition("_")[0]: value for name, value in apple.items()}
    assert len(known) > 10
    for tagname, per_100_g in known:
        if tagname not in ("FAT", "SUGAR"):  # they stand there as fat_g and sugar_g
            assert by_tagname[tagname] == pytest.approx(2.0 * per_100_g)
    assert {unknown[f"{name}"] for name in apple if name.startswith(("FE_", "CA_", "VITC_"))} == {None}
    (row,) = [row for row in read_csv(client, admin, "/v1/records", components="all") if row["consumed_g"] == ""]
    assert row["FE_mg"] == ""
    long = read_ndjson(client, admin, "/v1/records", layout="long", components="all", participant="=1+2")
    iron = [row for row in long if row["tagname"] == "FE"]
    assert sorted((row["known"], row["amount"] is None, row["per_100_g"] is None) for row in iron) == [
        (False, True, True),
        (True, False, False),
    ]


def test_geojson_has_a_point_where_the_study_keeps_locations_and_null_elsewhere(study, client, admin, state):
    for path in ("/v1/meals", "/v1/records"):
        answer = client.get(path, headers=admin, params={"format": "geojson"})
        assert answer.headers["content-type"] == "application/geo+json"
        told = answer.json()
        assert told["type"] == "FeatureCollection"
        rows = read_ndjson(client, admin, path)
        assert [feature["id"] for feature in told["features"]] == [row.get("id", row["meal_id"]) for row in rows]
        for feature, row in zip(told["features"], rows, strict=True):
            assert feature["type"] == "Feature"
            place = {"type": "Point", "coordinates": [PLACE["longitude"], PLACE["latitude"]]}
            assert feature["geometry"] == (place if row["participant"] == "P001" else None)
            assert feature["properties"] == {
                name: value for name, value in row.items() if name not in ("longitude", "latitude")
            }
    with state.database.write() as session:
        meal = session.scalars(sa.select(Meal).where(Meal.local_date == date(2026, 11, 2))).one()
        meal.details = meal.details | {"location": {"latitude": -33.5, "longitude": -70.25}}
    told = client.get("/v1/records", headers=admin, params={"format": "geojson"}).json()
    assert [feature["geometry"]["coordinates"] for feature in told["features"]] == [[-70.25, -33.5]] * 2
    nothing = client.get("/v1/records", headers=admin, params={"format": "geojson", "from": "2027-01-01"}).json()
    assert nothing == {"type": "FeatureCollection", "features": []}
    (meal,) = [row for row in read_ndjson(client, admin, "/v1/meals") if row["participant"] == "P001"]
    assert (meal["longitude"], meal["latitude"]) == (PLACE["longitude"], PLACE["latitude"])
    with state.database.write() as session:
        session.execute(sa.update(Study).values(location_policy="drop"))
    told = client.get("/v1/meals", headers=admin, params={"format": "geojson"}).json()
    assert [feature["geometry"] for feature in told["features"]] == [None, None]
    assert {row["longitude"] for row in read_csv(client, admin, "/v1/meals")} == {""}


def test_what_no_table_has_is_refused_by_name_and_reversed_days_in_every_format(study, client, admin):
    reversed_days = {"from": "2026-11-03", "to": "2026-11-02"}
    refusals = [
        ("/v1/records", {"layout": "long"}, "export_not_offered"),
        ("/v1/meals", {"components": "all"}, "export_not_offered"),
        ("/v1/days", {"format": "geojson"}, "export_not_offered"),
        ("/v1/records", {"format": "geojson", "layout": "long"}, "export_not_offered"),
        ("/v1/studies/pilot/photographs", {"format": "geojson"}, "export_not_offered"),
        ("/v1/studies/pilot/participants", {"format": "geojson"}, "export_not_offered"),
        ("/v1/data-dictionary", {"rows": "photographs", "layout": "long"}, "export_not_offered"),
        ("/v1/data-dictionary", {"rows": "participants", "components": "all"}, "export_not_offered"),
    ]
    refusals += [
        (path, reversed_days | {"format": form}, "days_reversed")
        for rows, path in TABLES.items()
        for form in ("json", "csv")
        if rows != "participants"
    ]
    for path, params, code in refusals:
        assert refusal(client.get(path, headers=admin, params=params)) == (422, code), (path, params)


def test_manifest_in_pages_has_what_the_file_has(study, client, admin):
    rows, path = [], "/v1/studies/pilot/photographs?limit=1"
    while path:
        page = client.get(path, headers=admin).json()
        rows += page["items"]
        path = page["next"]
    in_file = read_ndjson(client, admin, "/v1/studies/pilot/photographs")
    assert rows == [{name: value for name, value in row.items() if name != "captured_local"} for row in in_file]
    assert [row["slot"] for row in rows] == ["left", "right"]
    assert client.get(rows[0]["path"], headers=admin).headers["content-type"] == "image/jpeg"


def test_rows_of_what_was_eaten_have_the_time_by_the_clock_there(study, client, admin, state):
    with state.database.write() as session:
        captured_at = datetime(2026, 11, 2, 1, 15, 0, 500000, UTC)
        session.execute(sa.update(Meal).values(captured_at=captured_at, utc_offset_minutes=-210))
        session.execute(sa.update(EffectiveRecord).values(captured_at=captured_at))
    for table in ("items", "meals", "photographs"):
        rows = read_ndjson(client, admin, TABLES[table])
        assert {(row["captured_at"], row["captured_local"]) for row in rows} == {
            ("2026-11-02T01:15:00.500000Z", "2026-11-01T21:45:00.500000")
        }
        file = client.get(TABLES[table], headers=admin, params={"format": "parquet"}).content
        assert set(parquet.read_table(io.BytesIO(file))["captured_local"].to_pylist()) == {
            datetime(2026, 11, 1, 21, 45, 0, 500000)  # noqa: DTZ001  # a wall clock has no zone
        }


def test_participants_have_their_profile_their_age_on_day_1_and_how_many_meals_there_are(
    study, client, admin, enrol, state
):
    path = "/v1/studies/pilot/participants"
    profile = {"sex": "female", "birth_year": 1990, "height_cm": 168.0, "is_pregnant": True, "trimester": 2}
    enrol("P003")
    for code, starts_on in (("=1+2", "2025-12-31"), ("P003", None)):
        body = {"profile": profile, "starts_on": starts_on}
        assert client.patch(f"{path}/{code}", headers=admin, json=body).status_code == 200
    with state.database.write() as session:  # nobody has a day 1 before the first meal: the age is of the enrolment
        session.execute(sa.update(Device).values(enrolled_at=datetime(2026, 10, 30, 8, tzinfo=UTC)))
    add_meal(state, "=1+2", "2026-11-04")
    rows = {row["participant"]: row for row in read_ndjson(client, admin, path)}
    assert list(rows) == ["=1+2", "P001", "P003"]
    of_days, of_nobody, of_no_meal = rows.values()
    assert [of_days[name] for name in ("age_years", "starts_on", "meals", "first_meal_on", "last_meal_on")] == [
        35, "2025-12-31", 2, "2026-11-02", "2026-11-04",
    ]  # fmt: skip
    assert {of_days[name] for name in ("sex", "height_cm", "trimester")} == {"female", 168.0, 2}
    assert {of_nobody[name] for name in ("sex", "age_years", "weight_kg", "is_pregnant", "starts_on")} == {None}
    assert [of_no_meal[name] for name in ("age_years", "enrolled_at", "meals", "last_meal_on")] == [
        36, "2026-10-30T08:00:00Z", 0, None,
    ]  # fmt: skip


def test_phone_gets_its_own_participants_rows_alone(study, client):
    for path in ("/v1/records", "/v1/meals", "/v1/days"):
        rows = read_ndjson(client, study.headers, path, components="all")
        assert {row["participant"] for row in rows} <= {"P001"}
    for rows in ("photographs", "participants"):
        assert client.get(TABLES[rows], headers=study.headers, params={"format": "csv"}).status_code == 403


def test_each_table_that_staff_take_is_noted_once(study, client, admin, state):
    for path in TABLES.values():
        client.get(
            path, headers=admin, params={"format": "ndjson"} | ({"study": "pilot"} if "pilot" not in path else {})
        )
    client.get("/v1/meals?study=pilot&format=csv&layout=long&components=all", headers=admin)
    parquet = {"Accept": "application/vnd.apache.parquet"}
    answer = client.get("/v1/records?study=pilot&food=apple", headers=admin | parquet)
    assert (answer.headers["content-type"], answer.content[:4]) == (parquet["Accept"], b"PAR1")
    assert 'filename="pilot_records.parquet"' in answer.headers["content-disposition"]
    client.get("/v1/days?study=pilot", headers=admin)  # a page is no export
    assert client.get("/v1/days?format=csv", headers=study.headers).status_code == 200
    client.get("/v1/days?format=csv&from=2026-11-01", headers=admin)
    with state.database.read() as session:
        events = session.scalars(sa.select(AuditEvent).where(AuditEvent.action.like("%.export"))).all()
    *of_study, last = events
    assert sorted(event.action for event in of_study) == [
        "days.export", "meals.export", "meals.export", "participants.export", "photographs.export", "records.export",
        "records.export",
    ]  # fmt: skip
    assert of_study[-1].details == {"output": "parquet", "filters": ["food_keys", "study_code"]}
    assert of_study[-2].details == {
        "output": "csv", "filters": ["study_code"], "layout": "long", "components": "all",
    }  # fmt: skip
    assert None not in {event.study_id for event in of_study}
    assert (last.action, last.study_id) == ("days.export", None)
    assert last.details == {"output": "csv", "filters": ["first_day"]}


def test_spec_comes_back_from_json_as_it_was():
    filters = RowFilter("pilot", first_day=date(2026, 11, 1), statuses=("failed", "queued"), needs="review")
    spec = ExportSpec("meals", "long", "parquet", "all", filters, provenance=False)
    told = json.loads(json.dumps(spec_as_json(spec)))
    assert spec_of_json(told) == spec
    assert told["filters"] == {
        "study_code": "pilot", "first_day": "2026-11-01", "statuses": ["failed", "queued"], "needs": "review",
    }  # fmt: skip
