"""What every answer of the API has, whoever made it."""

import pytest


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/v1/me", 200),
        ("/v1/meals", 200),
        ("/v1/records?study=pilot", 200),
        ("/v1/meals/no-id", 422),
        ("/v1/nowhere", 404),
    ],
)
def test_json_is_not_guessed_at_and_not_kept(phone, path, status):
    """`/v1/me` went out without Cache-Control, JSON and CSV without nosniff."""
    answer = phone.get(path)
    assert answer.status_code == status
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["cache-control"] == "private, no-store"


def test_csv_is_not_guessed_at_and_not_kept(client, admin, phone):
    answer = client.get("/v1/records?study=pilot&format=csv", headers=admin)
    assert answer.headers["content-type"].startswith("text/csv")
    assert (answer.headers["x-content-type-options"], answer.headers["cache-control"]) == (
        "nosniff",
        "private, no-store",
    )
