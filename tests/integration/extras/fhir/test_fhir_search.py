"""Searching NutritionIntakes: by participant and date, pages, permissions, refusals."""

import itertools
from datetime import UTC, datetime, timedelta

import pytest

from tests.integration.diary.eaten_days import add_meal, eaten_item
from tests.integration.people.people import make_staff
from tests.support.fhir_models import bundle, error_of, link, valid

URL = "/fhir/NutritionIntake"


def ids(answer):
    return [resource["id"] for resource in bundle(answer)]


def crawl(client, headers, query=""):
    """The ids of each page, from the first to the last."""
    pages, url = [], f"{URL}?{query}"
    while url:
        answer = client.get(url, headers=headers)
        pages.append(ids(answer))
        url = link(answer, "next")
    return pages


def record_ids(client, headers, **params):
    rows = client.get("/v1/records", headers=headers, params=params | {"limit": 1000}).json()["items"]
    return [row["id"] for row in rows if row["status"] != "rejected"]


@pytest.fixture
def two_studies(enrol, state):
    """Three participants; the same code twice. Their phones."""
    phones = {name: enrol(*name) for name in (("P001", "pilot"), ("P002", "pilot"), ("P001", "my_study"))}
    for (code, study), day in itertools.product(phones, ("2026-10-31", "2026-11-01", "2026-11-02")):
        foods = [eaten_item(100.0, food="apple"), eaten_item(None, status="needs_review")]
        add_meal(state, code, day, *foods, eaten_item(None, status="rejected"), study=study)
        add_meal(state, code, day, eaten_item(50.0, provisional=day.endswith("02")), study=study, hour=20)
    return phones


def test_pages_hold_every_record_once_in_the_order_of_capture_and_100_at_most(client, admin, state, two_studies):
    (everything,) = crawl(client, admin)
    assert everything == record_ids(client, admin)
    assert len(everything) == 27
    for query in ("", "patient=pilot|P002", "status=in-progress", "date=ge2026-11-01"):
        (whole,) = crawl(client, admin, query)
        assert whole
        pages = crawl(client, admin, f"{query}&_count=4".lstrip("&"))
        assert [key for page in pages for key in page] == whole
        assert all(len(page) == 4 for page in pages[:-1])
    for day in (1, 2):
        add_meal(state, "P001", f"2026-12-{day:02d}", *(eaten_item() for _ in range(45)))
    assert [len(page) for page in crawl(client, admin, "_count=1000")] == [100, 17]
    assert len(crawl(client, admin)[0]) == 50


DAYS = [
    (["date=gt2026"], {"from": "2027-01-01"}),
    (["date=2026-11-01"], {"from": "2026-11-01", "to": "2026-11-01"}),
    (["date=2026-11"], {"from": "2026-11-01", "to": "2026-11-30"}),
    (["date=2026"], {"from": "2026-01-01", "to": "2026-12-31"}),
    (["date=ge2026-11-01"], {"from": "2026-11-01"}),
    (["date=gt2026-10"], {"from": "2026-11-01"}),
    (["date=sa2026-10-31"], {"from": "2026-11-01"}),
    (["date=lt2026-11"], {"to": "2026-10-31"}),
    (["date=eb2026-11-01"], {"to": "2026-10-31"}),
    (["date=le2026-10-31"], {"to": "2026-10-31"}),
    (["date=gt2026-10-31", "date=lt2026-11-02"], {"from": "2026-11-01", "to": "2026-11-01"}),
    (["date=ge2026-10-01", "date=ge2026-11-01", "date=le2026-12"], {"from": "2026-11-01"}),
]


@pytest.mark.usefixtures("two_studies")
def test_days_are_local_days_as_in_records(client, admin):
    for query, filters in DAYS:
        found = ids(client.get(f"{URL}?{'&'.join(query)}", headers=admin))
        assert found == record_ids(client, admin, **filters), query
    of_person = ids(client.get(f"{URL}?subject=Patient/my..study.P001&{'&'.join(query)}", headers=admin))
    assert of_person == record_ids(client, admin, study="my_study", participant="P001", **filters)


@pytest.mark.usefixtures("phone")
def test_a_day_is_the_participants_own_and_an_instant_everybodys(client, admin, state, enrol):
    enrol("P009", "night", day_starts="04:00")
    add_meal(state, "P009", "2026-11-02", eaten_item(), study="night", hour=2)
    instant = datetime(2026, 11, 2, 2, tzinfo=UTC)

    def found(*dates):
        return len(ids(client.get(URL, headers=admin, params={"date": list(dates), "subject": "Patient/night.P009"})))

    for shift in (timedelta(hours=8), timedelta(hours=-5), timedelta(0)):
        local = (instant + shift).strftime("%Y-%m-%dT%H:%M:%S") + f"{'-' if shift < timedelta(0) else '+'}"
        local += f"{abs(shift).seconds // 3600:02d}:00"
        assert [found(f"{prefix}{local}") for prefix in ("", "eq", "ge", "le", "gt", "lt", "sa", "eb")] == [
            1, 1, 1, 1, 0, 0, 0, 0,
        ]  # fmt: skip
    assert found("2026-11-02T02:00Z") == 1  # the minute
    assert found("2026-11-02T02:00:00.000001Z") == 0
    assert found("gt2026-11-02T01:59:59Z", "lt2026-11-02T02:00:01Z") == 1
    assert found("gt2026-11-02T01:59:59Z", "lt2026-11-02T02:00:00Z") == 0


FORMS = [
    "subject=Patient/pilot.P002",
    "subject:Patient=pilot.P002",
    "subject=http://testserver/fhir/Patient/pilot.P002",
    "subject=Patient/P002",
    "subject=pilot|P002",
    "subject:identifier=pilot|P002",
    "subject.identifier=http://testserver/fhir/sid/studies/pilot/participants|P002",
    "subject=Patient/pilot.P002,Patient/pilot.P777",
    "subject=Patient/pilot.P002,Patient/pilot.P001&patient=P002",
]


@pytest.mark.usefixtures("two_studies")
def test_a_person_is_named_in_every_way_of_the_standard(client, admin):
    expected = record_ids(client, admin, study="pilot", participant="P002")
    assert len(expected) == 9
    for form in FORMS:
        assert ids(client.get(f"{URL}?{form}", headers=admin)) == expected, form


NOBODY = [
    "subject=Patient/pilot.P777",
    "subject=Group/pilot.P002",
    "subject=https://elsewhere.example.org/fhir/Patient/pilot.P002",
    "subject:identifier=|P002",
    "subject=Patient/pilot.P001&patient=Patient/pilot.P002",
    "subject=Patient/..",
    "status=stopped",
    "status=completed&status=in-progress",
    "_id=00000000-0000-0000-0000-000000000000",
    "identifier=https://elsewhere.example.org/|00000000-0000-0000-0000-000000000000",
]


@pytest.mark.usefixtures("two_studies")
def test_what_names_nobody_finds_nothing_rather_than_everything(client, admin):
    for form in NOBODY:
        assert "entry" not in valid(client.get(f"{URL}?{form}", headers=admin)), form


def test_a_code_that_two_studies_have_must_be_named_with_its_study(client, admin, two_studies):
    assert error_of(client.get(f"{URL}?subject=Patient/P001", headers=admin)) == (400, "patient_ambiguous")
    viewer = make_staff(client, admin, "eve", pilot="viewer")
    expected = record_ids(client, admin, study="pilot", participant="P001")
    assert ids(viewer.get(f"{URL}?subject=Patient/P001")) == expected
    phone = two_studies["P001", "my_study"]
    assert ids(phone.get(URL, subject="P001")) == record_ids(client, phone.headers)


def test_ids_find_what_they_name_within_the_other_filters(client, admin, two_studies):
    one, *_, other = record_ids(client, admin, study="pilot")
    assert ids(client.get(f"{URL}?_id={other},{one}", headers=admin)) == [one, other]
    system = "http://testserver/fhir/sid/items"
    assert ids(client.get(f"{URL}?identifier={system}|{one},{other}", headers=admin)) == [one, other]
    assert ids(client.get(f"{URL}?_id={one},{other}&_id={one}", headers=admin)) == [one]
    assert ids(client.get(f"{URL}?_id={one},{other}&date=2026-10-31", headers=admin)) == [one]
    assert ids(two_studies["P001", "my_study"].get(URL, _id=one)) == []


def test_each_sees_their_own_and_what_is_not_theirs_is_not_found(client, admin, two_studies):
    viewer = make_staff(client, admin, "eve", my_study="viewer")
    phone = two_studies["P002", "pilot"]
    assert ids(viewer.get(URL)) == record_ids(client, admin, study="my_study")
    assert ids(phone.get(URL)) == record_ids(client, admin, study="pilot", participant="P002")
    assert ids(make_staff(client, admin, "mallory").get(URL)) == []
    assert ids(viewer.get(f"{URL}?subject=Patient/pilot.P002")) == []
    assert ids(phone.get(URL, subject="Patient/pilot.P001")) == []
    own = record_ids(client, admin, study="pilot", participant="P001")[0]
    for caller in (viewer, phone):
        for path in (f"{URL}/{own}", "/fhir/Patient/pilot.P001", "/fhir/Patient/pilot.P777", f"{URL}/x"):
            assert error_of(caller.get(path)) == (404, "not_found")
    assert valid(phone.get("/fhir/Patient/pilot.P002"))["id"] == "pilot.P002"
    assert valid(viewer.get("/fhir/Patient/my..study.P001"))["id"] == "my..study.P001"
    assert error_of(viewer.get("/fhir/Patient/P001")) == (404, "not_found")  # a resource has one id


@pytest.mark.usefixtures("two_studies")
def test_a_parameter_that_is_not_known_is_ignored_and_told_or_refused_where_that_is_wanted(client, admin):
    query = "_lastUpdated=gt2026&date=2026-11-01&_total=accurate&_sort=-date&_sort=date&code=x&_format=json"
    answer = client.get(f"{URL}?{query}", headers=admin)
    assert ids(answer) == ids(client.get(f"{URL}?date=2026-11-01", headers=admin))
    assert link(answer, "self") == "http://testserver/fhir/NutritionIntake?date=2026-11-01&_sort=date"
    outcome = answer.json()["entry"][-1]
    assert (outcome["search"], outcome["resource"]["resourceType"]) == ({"mode": "outcome"}, "OperationOutcome")
    told = " ".join(issue["details"]["text"] for issue in outcome["resource"]["issue"])
    assert all(name in told for name in ("_lastUpdated", "_total", "_sort", "code"))
    strict = client.get(f"{URL}?{query}", headers=admin | {"Prefer": "respond-async, handling=strict"})
    assert error_of(strict) == (400, "search_parameter_unsupported")
    assert ids(client.get(f"{URL}?date=2026-11-01", headers=admin | {"Prefer": "handling=strict"}))


BAD = [
    "date=yesterday", "date=2026-13", "date=2026-02-30", "date=ne2026", "date=ap2026", "date=", "date=2026-1-1",
    "date=2026-11-01T10:00:00", "date=2026-11-01T25:00:00Z", "date=2026-11-01T10:00:00 08:00",
    "date=2026-11-01,2026-11-02", "date=0000", "date=gt9999-12-31", "date=gt9999-12-31T23:59:59Z",
    "date=0001-01-01T00:00:00%2B14:00", "status=eaten", "status=", "subject=", "subject=a,,b", "_count=0", "_count=-1",
    "_count=x", "_count=%C2%B2", "_count=", "_id=" + ",".join(["x"] * 51), "_cursor=x", "_cursor=e30",
]  # fmt: skip


@pytest.mark.usefixtures("two_studies")
def test_a_value_that_cannot_be_read_is_refused_and_one_at_the_end_of_its_range_answered(client, admin):
    for query in BAD:
        code = "cursor_invalid" if "_cursor" in query else "search_parameter_invalid"
        assert error_of(client.get(f"{URL}?{query}", headers=admin)) == (400, code), query
    for query in (
        "date=0001", "date=9999", "date=ge0001-01-01", "date=le9999-12-31", "date=lt9999-12-31T23:00:00Z",
        "date=ge0001-01-02T00:00:00Z", "_count=99999999999999999999", "subject=Patient/" + "x" * 300,
    ):  # fmt: skip
        valid(client.get(f"{URL}?{query}", headers=admin))


@pytest.mark.usefixtures("two_studies")
def test_a_cursor_is_bound_to_its_filters(client, admin):
    following = link(client.get(f"{URL}?date=2026-11-01&_count=1", headers=admin), "next")
    assert "date=2026-11-01" in following
    assert error_of(client.get(f"{following}&status=completed", headers=admin)) == (400, "cursor_of_other_filters")
    assert len(ids(client.get(following.replace("_count=1", "_count=3"), headers=admin))) == 3


FORMATS = [
    ({}, "", 200), ({"Accept": "*/*"}, "", 200), ({"Accept": "application/fhir+json"}, "", 200),
    ({"Accept": "application/fhir+xml, application/json;q=0.5"}, "", 200),
    ({"Accept": "application/fhir+json; fhirVersion=5.0"}, "", 200),
    ({"Accept": "application/fhir+json; fhirVersion=4.0"}, "", 406), ({"Accept": "application/fhir+xml"}, "", 406),
    ({"Accept": "text/turtle"}, "", 406), ({"Accept": "text/turtle"}, "?_format=json", 200), ({}, "?_format=xml", 406),
    ({}, "?_format=application/fhir%2Bjson", 200), ({}, "?_format=application/fhir+json", 200),
    ({}, "?_format=ttl", 406),
]  # fmt: skip


@pytest.mark.usefixtures("phone")
def test_resources_are_given_as_json_only(client, admin):
    for headers, query, status in FORMATS:
        answer = client.get(f"{URL}{query}", headers=admin | headers)
        if status == 200:
            valid(answer)
        else:
            assert error_of(answer) == (status, "not_acceptable"), (headers, query)
    for path in ("/fhir/metadata", "/fhir/Patient/pilot.P001"):
        assert error_of(client.get(f"{path}?_format=xml", headers=admin)) == (406, "not_acceptable")


def test_errors_are_outcomes_wherever_they_come_from(client, admin, phone):
    assert error_of(client.get(URL)) == (401, "unauthenticated")
    assert client.get(URL).headers["www-authenticate"] == "Bearer"
    assert error_of(client.get("/fhir/Observation", headers=admin)) == (404, "not_found")
    assert error_of(client.get("/fhir", headers=admin)) == (404, "not_found")
    assert error_of(client.post(URL, headers=admin, json={})) == (405, "method_not_allowed")
    assert error_of(client.get(f"{URL}?subject=%00", headers=admin)) == (400, "invalid_input")
    assert error_of(client.get(f"{URL}/{'x' * 500}", headers=admin)) == (400, "invalid_input")
    assert client.get("/fhirx", headers=admin).headers["content-type"] == "application/problem+json"
    assert client.get("/v1/meals/x", headers=admin).headers["content-type"] == "application/problem+json"
