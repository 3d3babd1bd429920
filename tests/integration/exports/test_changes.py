"""After each pull of a study's changes a client has what the server has: nothing missed, erased records gone."""

import hashlib

import pytest

from tests.integration.records.eating import eaten
from tests.support.estimates import found_item


class Copy:
    """A reader's copy of a study, kept up to date by pulling."""

    def __init__(self, client, headers, limit=2):
        self.client, self.headers = client, headers
        self.next = f"/v1/studies/pilot/changes?limit={limit}"
        self.records, self.days, self.pulled = {}, {}, 0

    def pull(self):
        while True:
            answer = self.client.get(self.next, headers=self.headers)
            assert answer.status_code == 200, answer.text
            page = answer.json()
            self.pulled += len(page["records"]) + len(page["days"]) + len(page["erased"])
            self.records |= {record["id"]: record for record in page["records"]}
            self.days |= {day["id"]: (day["participant"], day["local_date"], day["status"]) for day in page["days"]}
            gone = {erased["id_sha256"] for erased in page["erased"]}
            for rows in (self.records, self.days):
                for key in [key for key in rows if hashlib.sha256(key.encode()).hexdigest() in gone]:
                    del rows[key]
            self.next = page["next"]
            if not page["has_more"]:
                return


def truth(client, headers):
    records = client.get("/v1/records?limit=1000", headers=headers).json()["items"]
    of_days = ("day_status", "study_day")  # told by the days themselves
    return {record["id"]: {key: record[key] for key in record if key not in of_days} for record in records}


def test_copy_is_the_server_s_after_each_pull(phone, state, client, admin):
    copy = Copy(client, admin)
    copy.pull()
    assert copy.records == {}
    items = [found_item(volume_ml=100.0 + n) for n in range(3)]
    kept = [eaten(phone, state, *items, seed=seed) for seed in range(3)]
    copy.pull()
    assert copy.records == truth(client, admin)
    assert len(copy.records) == 9
    pulled = copy.pulled
    copy.pull()
    assert copy.pulled == pulled  # nothing changed, nothing comes again
    phone.put("/v1/me/days/2026-11-20", json={"status": "closed"}, headers={"If-Match": '"0"'})
    item = client.get(f"/v1/meals/{kept[0]}", headers=admin)
    event = {"id": "8f0ccda4-7f0e-4e34-9a39-1f0c6d3bb9c1", "kind": "reject", "item": item.json()["items"][0]["id"]}
    said = client.post(
        f"/v1/meals/{kept[0]}/events", headers=phone.headers | {"If-Match": item.headers["etag"]}, json=event
    )
    assert said.status_code in {200, 201}, said.text
    assert client.delete(f"/v1/meals/{kept[1]}", headers=phone.headers).status_code in {200, 204}
    copy.pull()
    assert copy.records.keys() == truth(client, admin).keys()
    assert len(copy.records) == 6
    statuses = {key: record["status"] for key, record in copy.records.items()}
    assert statuses == {key: record["status"] for key, record in truth(client, admin).items()}
    assert list(copy.days.values()) == [("P001", "2026-11-20", "closed")]


@pytest.mark.parametrize("policy", ["anonymise", "erase"])
def test_copy_forgets_who_has_left(enrol, state, client, admin, policy):
    phone, other = enrol("P001", withdrawal_policy=policy), enrol("P002")
    copy = Copy(client, admin)
    for one, seed in ((phone, 1), (other, 2)):
        eaten(one, state, seed=seed)
        one.put("/v1/me/days/2026-11-20", json={"status": "closed"}, headers={"If-Match": '"0"'})
    copy.pull()
    assert {participant for participant, _, _ in copy.days.values()} == {"P001", "P002"}
    assert client.post("/v1/me/withdrawal", headers=phone.headers).status_code in {200, 201}
    copy.pull()
    left = {record["participant"] for record in copy.records.values()}
    assert left == {participant for participant, _, _ in copy.days.values()}
    assert len(left) == (1 if policy == "erase" else 2)
    assert "P001" not in left
    assert copy.records == truth(client, admin)
