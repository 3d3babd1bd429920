"""A list whose filter names nothing that is there is refused: an empty one would pass for a study without meals."""

import uuid

import pytest

from tests.support.photographs import pair

LISTS = ("/v1/records", "/v1/meals", "/v1/days")


@pytest.fixture
def meal(phone):
    return phone.post(pair()).json()


@pytest.mark.parametrize("output", ["json", "csv"])
def test_study_participant_or_food_that_is_not_there_is_named(client, admin, phone, meal, output):
    def asked(path, headers=admin, **params):
        answer = client.get(path, headers=headers, params=params | {"format": output})
        return answer.status_code, answer.json()["code"]

    for path in LISTS:
        assert asked(path, study="nope") == (404, "not_found")
        assert asked(path, study="pilot", participant="NOPE") == (404, "not_found")
        assert asked(path, participant="NOPE") == (404, "not_found")
    for path in LISTS[:2]:
        assert asked(path, food=["apple", "nosuch"]) == (422, "food_unknown")
        assert asked(path, phone.headers, participant="P999") == (404, "not_found")
    assert asked("/v1/studies/nope/photographs") == (404, "not_found")
    assert asked("/v1/studies/pilot/photographs", participant="NOPE") == (404, "not_found")


def test_what_is_there_is_listed(client, admin, phone, meal):
    for headers in (admin, phone.headers):
        listed = client.get("/v1/meals", headers=headers, params={"study": "pilot", "participant": "P001"}).json()
        assert [row["id"] for row in listed["items"]] == [meal["id"]]
        assert client.get("/v1/meals?food=apple", headers=headers).json()["items"] == []


def test_page_of_photographs_holds_as_many_as_were_asked_for(client, admin, phone, meal):
    for hour in (10, 11, 12):
        body = {"id": str(uuid.uuid4()), "captured_at": f"2026-11-20T{hour}:00:00Z", "time_zone": "UTC"}
        answer = client.post("/v1/declared-meals", headers=phone.headers, json=body | {"items": [{"food": "apple"}]})
        assert answer.status_code == 201, answer.text
    phone.post(pair(2), captured_at="2026-11-20T13:00:00Z", time_zone="UTC")
    rows, sizes, path = [], [], "/v1/studies/pilot/photographs?limit=3"
    while path:
        page = client.get(path, headers=admin).json()
        rows += page["items"]
        sizes.append(len(page["items"]))
        path = page["next"]
    assert sizes == [3, 1]
    assert [row["slot"] for row in rows] == ["left", "right"] * 2
    assert len({row["meal_id"] for row in rows}) == 2
