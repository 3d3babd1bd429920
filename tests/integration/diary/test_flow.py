"""A study's flow: each participant is counted once, at the first stage that holds."""

from tests.integration.diary.eaten_days import add_meal, close, eaten_item

PATH = "/v1/studies/pilot/flow"
PEOPLE = "/v1/studies/pilot/participants"


def make_study(client, admin, enrol, state):
    """A1, A2 have two and one complete days; A3 never enrolled; B1 is excluded; B2 left; B3's data are erased."""
    for code, days in (("A1", 2), ("A2", 1), ("B1", 2), ("B2", 2), ("B3", 0)):
        phone = enrol(code, withdrawal_policy="keep")
        for number in range(1, days + 1):
            add_meal(state, code, f"2026-11-0{number}", eaten_item())
            close(phone, f"2026-11-0{number}")
    client.post(PEOPLE, headers=admin, json={"code": "A3", "arm": "A", "excluded": "no consent"})
    for code in ("A1", "A2", "B1", "B2", "B3"):
        client.patch(f"{PEOPLE}/{code}", headers=admin, json={"arm": code[0]})
    for code in ("B1", "B2"):
        client.patch(f"{PEOPLE}/{code}", headers=admin, json={"excluded": "<b>diabetes</b>"})
    assert client.post(f"{PEOPLE}/B2/withdrawal", headers=admin).is_success
    policy = {"withdrawal_policy": "erase"}
    assert client.patch("/v1/studies/pilot", headers=admin | {"If-Match": "*"}, json=policy).is_success
    assert client.post(f"{PEOPLE}/B3/withdrawal", headers=admin).is_success


def test_each_participant_is_counted_once_also_the_erased(client, admin, enrol, state):
    make_study(client, admin, enrol, state)
    rows = client.get(PATH, headers=admin, params={"least_days": 2}).json()["items"]
    assert {(row["stage"], row["arm"], row["reason"]): row["participants"] for row in rows} == {
        ("analysed", "A", None): 1,
        ("too_few_days", "A", None): 1,
        ("not_enrolled", "A", "no consent"): 1,
        ("excluded", "B", "<b>diabetes</b>"): 1,
        ("withdrawn", "B", None): 1,
        ("withdrawn", None, None): 1,
    }
    by_default = client.get(PATH, headers=admin).json()["items"]
    assert {row["stage"] for row in by_default} == {"too_few_days", "not_enrolled", "excluded", "withdrawn"}
    lines = client.get(PATH, headers=admin, params={"format": "csv", "least_days": 2}).text.splitlines()
    assert lines[0] == "stage,reason,arm,participants"
    assert len(lines) == 7
    assert client.get(PATH, headers=admin, params={"least_days": 0}).status_code == 422
