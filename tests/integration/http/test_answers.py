"""What every answer of the API has, whoever made it."""

ANSWERS = {
    "/v1/me": 200,
    "/v1/meals": 200,
    "/v1/records?study=pilot": 200,
    "/v1/meals/no-id": 422,
    "/v1/nowhere": 404,
}


def test_json_and_csv_are_not_guessed_at_and_not_kept(client, admin, phone):
    """`/v1/me` went out without Cache-Control, JSON and CSV without nosniff."""
    answers = {path: phone.get(path) for path in ANSWERS}
    assert {path: answer.status_code for path, answer in answers.items()} == ANSWERS
    csv = client.get("/v1/records?study=pilot&format=csv", headers=admin)
    assert csv.headers["content-type"].startswith("text/csv")
    for answer in (*answers.values(), csv):
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["cache-control"] == "private, no-store"
