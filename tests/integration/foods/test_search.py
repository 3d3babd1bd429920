"""GET /v1/foods and /v1/food-groups over the starter table."""


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


def test_what_is_too_long_out_of_range_or_has_a_nul_is_refused(phone):
    nul = "apple\x00"
    for params in ({"q": "a" * 101}, {"limit": 0}, {"limit": 1001}, {"group": "a" * 101}, {"q": nul}, {"group": nul}):
        assert phone.get("/v1/foods", **params).status_code == 422, params


def test_groups_lead_to_their_foods(phone):
    groups = phone.get("/v1/food-groups").json()["items"]
    assert [group["name"] for group in groups] == sorted(group["name"] for group in groups)
    for group in groups[:3]:
        foods = found(phone, group=group["name"].upper(), limit=1000)
        assert len(foods) == group["foods"]
        assert {food["group"] for food in foods} == {group["name"]}
    assert found(phone, q="apple", group="no such group") == found(phone, group="%") == []
