from app.http.flat_list import FORMULA_STARTS, safe_cell


def test_food_shows_nutrients_densities_and_sources_by_its_key_or_number(phone):
    food = phone.get("/v1/foods/apple").json()
    contents = {nutrient["tagname"]: nutrient["per_100_g"] for nutrient in food["nutrients"]}
    assert (contents["ENERC_KCAL"], contents["CHOCDF"]) == (52.0, 13.81)
    assert food["source_ids"]["sr28_ndb"] == "09003"
    density = food["density"]
    assert density["chosen"]["basis"] == "measured"
    assert density["reason"].startswith("measured for this food")
    assert density["alternatives"]
    assert all(other["source"] and other["reason"] for other in density["alternatives"])
    assert phone.get("/v1/foods/09003").json() == food
    answer = phone.get("/v1/foods/nothing")
    assert (answer.status_code, answer.json()["code"]) == (404, "food_not_found")


def test_ready_without_a_worker_tells_so_and_stays_ready(client):
    answer = client.get("/readyz")
    assert answer.status_code == 200
    assert answer.json() == {
        "ready": True,
        "checks": {"database": "ok", "blob_store": "ok", "disk": "ok"},
        "workers_alive": 0,
        "oldest_waiting_seconds": None,
    }


def test_ready_fails_on_an_unwritable_store(client, state, monkeypatch):
    def broken(_):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(type(state.blobs), "check", broken)
    answer = client.get("/readyz")
    assert (answer.status_code, answer.json()["ready"]) == (503, False)
    assert "Input/output error" in answer.json()["checks"]["blob_store"]


def test_formulas_are_neutralised_and_numbers_are_not():
    """Excel computes full-width signs of Chinese and Japanese keyboards, and skips a line feed before a formula."""
    signs = ("=1+2", "+x", "-x", "@x", "\tx", "\r=1", "\n=1+2", "＝1+2", "＋1", "－1", "＠SUM(1)")
    for text in (*(f"{start}1+1" for start in FORMULA_STARTS), *signs):
        assert safe_cell(text) == f"'{text}"
    assert safe_cell(-1.5) == -1.5
    assert safe_cell("P001") == "P001"
