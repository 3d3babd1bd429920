"""GET /v1/foods and /v1/food-groups over the starter table."""

import pytest


def found(phone, **params):
    answer = phone.get("/v1/foods", **params)
    assert answer.status_code == 200, answer.text
    return answer.json()["items"]


def test_a_match_says_what_matched_and_what_the_food_is(phone):
    (apple, *_) = found(phone, q="red aple")
    assert apple["key"] == "apple"
    assert "red" in apple["matched"].lower()
    assert (apple["state"], apple["is_mixed_dish"], apple["group"]) == ("raw", False, "Fruits and Fruit Juices")
    assert "starter" in apple["release"]


@pytest.mark.parametrize("q", ["%", "_", "\U0001f34e", "'; --", "\u202e", "x" * 100, "% " * 50])
def test_nothing_is_found_for_signs(phone, q):
    assert [food["key"] for food in found(phone, q=q)] == []


@pytest.mark.parametrize("name", ["q", "group"])
def test_nul_is_refused(phone, name):
    assert phone.get("/v1/foods", **{name: "apple\x00"}).status_code == 422


def test_an_empty_query_lists_the_table(phone):
    assert found(phone, q="", limit=5) == found(phone, limit=5)
    assert len(found(phone, limit=5)) == 5


def test_one_letter_is_answered(phone):
    assert all(any(word.lower().startswith("b") for word in match["matched"].split()) for match in found(phone, q="b"))


@pytest.mark.parametrize("params", [{"q": "a" * 101}, {"limit": 0}, {"limit": 1001}, {"group": "a" * 101}])
def test_what_is_too_long_or_out_of_range_is_refused(phone, params):
    assert phone.get("/v1/foods", **params).status_code == 422


def test_groups_lead_to_their_foods(phone):
    groups = phone.get("/v1/food-groups").json()["items"]
    assert [group["name"] for group in groups] == sorted(group["name"] for group in groups)
    for group in groups[:3]:
        foods = found(phone, group=group["name"].upper(), limit=1000)
        assert len(foods) == group["foods"]
        assert {food["group"] for food in foods} == {group["name"]}


def test_an_unknown_group_has_no_foods(phone):
    assert found(phone, q="apple", group="no such group") == found(phone, group="%") == []


def test_groups_need_a_token(client):
    assert client.get("/v1/food-groups").status_code == 401
