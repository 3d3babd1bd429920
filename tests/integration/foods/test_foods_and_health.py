from app.http.tables.csv_rows import FORMULA_STARTS, safe_cell


def test_search_gives_the_raw_apple_first(phone):
    found = phone.get("/v1/foods", q="apple").json()["items"]
    assert found[0]["key"] == "apple"


def test_food_shows_nutrients_densities_and_sources(phone):
    food = phone.get("/v1/foods/apple").json()
    contents = {nutrient["tagname"]: nutrient["per_100_g"] for nutrient in food["nutrients"]}
    assert (contents["ENERC_KCAL"], contents["CHOCDF"]) == (52.0, 13.81)
    assert food["source_ids"]["sr28_ndb"] == "09003"
    density = food["density"]
    assert density["chosen"]["basis"] == "measured"
    assert density["reason"].startswith("measured for this food")
    assert density["alternatives"]
    assert all(other["source"] and other["reason"] for other in density["alternatives"])


def test_food_is_found_by_its_number_in_a_published_table(phone):
    assert phone.get("/v1/foods/09003").json()["key"] == "apple"


def test_unknown_food_is_404(phone):
    answer = phone.get("/v1/foods/nothing")
    assert (answer.status_code, answer.json()["code"]) == (404, "food_not_found")


def test_without_words_all_foods_are_listed(phone):
    assert len(phone.get("/v1/foods").json()["items"]) > 50


def test_health_needs_no_token(client):
    assert client.get("/healthz").json() == {"status": "ok"}


def test_load_balancer_may_ask_by_head(client):
    assert (client.head("/healthz").status_code, client.head("/readyz").status_code) == (200, 200)


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


def test_answers_carry_a_request_id(client):
    assert len(client.get("/healthz").headers["x-request-id"]) == 32


def test_line_feed_and_full_width_signs_begin_a_formula_too():
    """Excel computes full-width signs of Chinese and Japanese keyboards, and skips a line feed before a formula."""
    for text in ("\n=1+2", "＝1+2", "＋1", "－1", "＠SUM(1)"):
        assert safe_cell(text) == "'" + text


def test_formulas_are_neutralised_and_numbers_are_not():
    for start in FORMULA_STARTS:
        assert safe_cell(f"{start}1+1") == f"'{start}1+1"
    assert safe_cell(-1.5) == -1.5
    assert safe_cell("P001") == "P001"
