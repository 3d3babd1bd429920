from datetime import UTC, datetime

from app.people.models import AccessToken, Enrolment


def issue(client, admin):
    client.post("/v1/studies", headers=admin, json={"code": "s", "name": "s"})
    client.post("/v1/studies/s/participants", headers=admin, json={"code": "P1"})
    return client.post("/v1/studies/s/participants/P1/enrolment-codes", headers=admin).json()["code"]


def exchange(client, code):
    return client.post("/v1/enrolments", json={"code": code, "device_name": "phone"})


def test_code_is_exchanged_once(client, admin):
    code = issue(client, admin)
    first, second = exchange(client, code), exchange(client, code)
    assert first.status_code == 201
    assert (first.json()["study"], first.json()["participant"]) == ("s", "P1")
    assert (second.status_code, second.json()["code"]) == (404, "enrolment_code_invalid")


def test_unknown_and_expired_code_give_the_same_answer(client, admin, state):
    code = issue(client, admin)
    with state.database.write() as session:
        session.query(Enrolment).one().expires_at = datetime.now(UTC)
    expired, unknown = exchange(client, code), exchange(client, "x" * 22)
    assert expired.status_code == unknown.status_code == 404
    assert expired.json() == unknown.json()


def test_secrets_are_stored_as_hashes_only(client, admin, state):
    code = issue(client, admin)
    token = exchange(client, code).json()["token"]
    with state.database.read() as session:
        stored = [row.token_sha256 for row in session.query(AccessToken)] + [
            row.code_sha256 for row in session.query(Enrolment)
        ]
    assert len(code) >= 22  # 128 bits in base64
    assert all(len(value) == 64 for value in stored)
    assert token not in stored
    assert code not in stored


def test_revoked_and_expired_tokens_are_401(client, admin, state):
    token = exchange(client, issue(client, admin)).json()["token"]
    headers = {"Authorization": f"Bearer {token}"}
    assert client.get("/v1/records", headers=headers).status_code == 200
    for column in ("revoked_at", "expires_at"):
        with state.database.write() as session:
            row = session.query(AccessToken).filter(AccessToken.device_id.is_not(None)).one()
            row.revoked_at = row.expires_at = None
            setattr(row, column, datetime.now(UTC))
        assert client.get("/v1/records", headers=headers).status_code == 401


def test_many_tries_are_slowed_down(client):
    answers = [exchange(client, f"guess-{n}") for n in range(70)]
    limited = [answer for answer in answers if answer.status_code == 429]
    assert limited
    assert limited[0].json()["code"] == "rate_limited"
    assert int(limited[0].headers["retry-after"]) >= 1


def test_study_and_participant_twice_are_conflicts(client, admin):
    issue(client, admin)
    assert client.post("/v1/studies", headers=admin, json={"code": "s", "name": "s"}).json()["code"] == "study_exists"
    again = client.post("/v1/studies/s/participants", headers=admin, json={"code": "P1"})
    assert (again.status_code, again.json()["code"]) == (409, "participant_exists")
    assert client.post("/v1/studies/zzz/participants", headers=admin, json={"code": "P1"}).status_code == 404
