"""Releases: a study's data frozen under a name; only erasures change them."""

import csv
import hashlib
import io
import json
import math
import uuid
from datetime import UTC, date, datetime, timedelta

import pytest
import sqlalchemy as sa
from pyarrow import parquet
from pydantic import SecretStr

from app.core.errors import StorageFullError
from app.exports import file_work_queries as file_work
from app.exports.release_models import Release, ReleaseChange, ReleaseFile
from app.exports.releases import release_runner
from app.exports.releases.compare_release import compare_release
from app.exports.releases.tables import LEFT_OUT
from app.foods.models import StudyDensity
from app.meals.stored.event_models import DiaryDay
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.record_models import EffectiveRecord
from app.nutrition.components import HEADLINE_COLUMNS
from app.people.access.last_use import LastUse
from app.people.models import Participant, Study
from app.privacy.delete_blobs import BlobDeleter
from tests.integration.diary.eaten_days import add_meal, eaten_item
from tests.integration.meals.upload.answers import refusal
from tests.integration.people.people import make_staff
from tests.integration.people.persons import database_bytes
from tests.support.commands import run_tada
from tests.support.stores import make_old, store_bytes, stored_names

PATH = "/v1/studies/pilot/releases"
NOT_DERIVABLE = LEFT_OUT["days"]
TABLES = ("items", "meals", "days", "photographs", "participants", "foods", "food_nutrients", "food_densities")
MARKED = "P-marked-7Kq"


@pytest.fixture
def eaten(enrol, state):
    """Three people, days of all kinds: two meals, one, none left to see, closed, with a word and without."""
    phones = {code: enrol(code) for code in (MARKED, "P002", "P003")}
    apple = {"energy_kcal": 52.0, "protein_g": 0.3, "volume_ml": 120.0, "volume_low_ml": 100.0, "volume_high_ml": 140.0}
    meals = {
        "two a": add_meal(state, MARKED, "2026-11-01", eaten_item(100.0, "apple", **apple), hour=8),
        "two b": add_meal(
            state,
            MARKED,
            "2026-11-01",
            eaten_item(0.1, "banana", energy_kcal=0.1),
            eaten_item(0.2, "apple", energy_kcal=0.2, status="rejected"),
            eaten_item(0.2, "apple", energy_kcal=None, provisional=True),
            hour=13,
            delay=timedelta(hours=3),
        ),
        "alone": add_meal(state, MARKED, "2026-11-02", eaten_item(None)),
        "closed": add_meal(state, MARKED, "2026-11-03", eaten_item(50.0, "banana", energy_kcal=44.0)),
        "late": add_meal(
            state, MARKED, "2026-11-03", eaten_item(-3.0, "apple", energy_kcal=-1.5), hour=20, delay=timedelta(days=3)
        ),
        "of another": add_meal(state, "P002", "2026-11-01", eaten_item(80.0, "apple", energy_kcal=41.6)),
        "confirmed empty": add_meal(state, "P003", "2026-11-04", status="confirmed"),
        "failed": add_meal(state, "P003", "2026-11-05", status="failed"),
        "seen": add_meal(state, "P003", "2026-11-05", eaten_item(9.0, "apple", origin="added"), hour=9),
    }  # fmt: skip
    with state.database.write() as session:
        for code, day in ((MARKED, 3), ("P003", 4)):
            person = session.scalars(sa.select(Participant).where(Participant.code == code)).one()
            closed = {"status": "closed", "ate_nothing": False, "changed_at": datetime(2026, 11, day, 22, tzinfo=UTC)}
            who = {"participant_id": person.id, "study_id": person.study_id}
            session.add(DiaryDay(local_date=date(2026, 11, day), change_seq=1, **who, **closed))
        for meal in session.scalars(sa.select(Meal)):
            digest = hashlib.sha256(meal.id.bytes).hexdigest()
            image = {"media_type": "image/jpeg", "width_px": 4, "height_px": 3, "bytes": 5, "slot": "left"}
            image |= {"received_sha256": digest, "stored_sha256": digest, "received_at": meal.received_at}
            key = f"{meal.study_id}/{meal.id}/left/{digest}"
            session.add(MealImage(id=uuid.uuid4(), meal_id=meal.id, blob_key=key, **image))
    return {"phones": phones, "meals": meals}


@pytest.fixture
def owner(client, admin, eaten):
    return make_staff(client, admin, "olga", pilot="owner")


def frozen(owner, run, name, **body):
    answer = owner.post(PATH, json={"name": name} | body)
    assert answer.status_code == 202, answer.text
    ended = run()
    assert ended.outcome == "done", ended
    release = owner.get(answer.headers["location"]).json()
    assert release["state"] == "ready"
    return release


def fetch(owner, release, name):
    answer = owner.get(f"{PATH}/{release['name']}/files/{name}")
    assert answer.status_code == 200, answer.text
    return answer.content


def rows(owner, release, table):
    return list(csv.DictReader(io.StringIO(fetch(owner, release, f"{table}.csv").decode(), newline="")))


def typed(owner, release, table):
    return parquet.read_table(io.BytesIO(fetch(owner, release, f"{table}.parquet"))).to_pylist()


def facts(owner, release):
    """What datapackage.json tells of the release itself."""
    return json.loads(fetch(owner, release, "datapackage.json"))["tada"]


def erase(eaten, meal):
    phone = eaten["phones"][MARKED]
    answer = phone.client.delete(f"/v1/meals/{eaten['meals'][meal]}", headers=phone.headers)
    assert answer.status_code == 200, answer.text


def test_release_has_every_table_with_verifiable_checksums(owner, run):
    release = frozen(owner, run, "baseline", note="for the paper")
    names = {f"{table}.{end}" for table in TABLES for end in ("csv", "parquet")}
    assert {file["name"] for file in release["files"]} == names | {"data-dictionary.csv", "datapackage.json"}
    lines = []
    for file in release["files"]:
        content = fetch(owner, release, file["name"])
        assert (hashlib.sha256(content).hexdigest(), len(content)) == (file["sha256"], file["bytes"])
        if file["name"] != "datapackage.json":
            lines.append(f"{file['sha256']}  {file['name']}\n")
    assert release["checksum"] == hashlib.sha256("".join(sorted(lines)).encode()).hexdigest()
    told = facts(owner, release)
    assert told["checksum"] == release["checksum"]
    assert (told["study"], told["note"], told["frozen_by"]) == ("pilot", "for the paper", "olga")
    assert told["protocol"]["marker"] == "plain:9x7:11"
    assert told["change_seq"] == release["change_seq"]
    assert sum(told["contents"]["food_tables"].values()) == 8
    assert len(told["tables"]) == len(TABLES)


def test_frozen_tables_are_the_exports_of_the_same_moment_with_the_foods_of_their_items(owner, run):
    release = frozen(owner, run, "baseline")
    dictionary = list(csv.DictReader(io.StringIO(fetch(owner, release, "data-dictionary.csv").decode())))
    assert all(row["meaning"] for row in dictionary)
    left_out = {"items": {"change_seq"}, "meals": {"version"}, "days": set(NOT_DERIVABLE), "photographs": set()}
    left_out["participants"] = {"meals", "first_meal_on", "last_meal_on"}
    for table, names_out in left_out.items():
        body = {"rows": table, "format": "csv", "components": "all" if table == "items" else "headline"}
        path = owner.post("/v1/studies/pilot/exports", json=body).headers["location"]
        assert run().outcome == "done"
        exported = list(csv.DictReader(io.StringIO(owner.get(path + "/file").text, newline="")))
        kept = rows(owner, release, table)
        assert kept
        assert set(exported[0]) - set(kept[0]) == names_out
        assert kept == [{name: value for name, value in row.items() if name not in names_out} for row in exported]
        assert [str(row["participant"]) for row in typed(owner, release, table)] == [row["participant"] for row in kept]
        assert [row["name"] for row in dictionary if row["table"] == table] == list(kept[0])
    assert [food["food_key"] for food in rows(owner, release, "foods")] == ["apple", "banana"]
    nutrients = rows(owner, release, "food_nutrients")
    energy = [row for row in nutrients if row["food_key"] == "apple" and row["tagname"] == "ENERC_KCAL"]
    [apple] = [one for one in owner.get("/v1/foods/apple").json()["nutrients"] if one["number"] == energy[0]["number"]]
    assert float(energy[0]["per_100_g"]) == apple["per_100_g"]
    assert {row["food_key"] for row in rows(owner, release, "food_densities")} == {"apple", "banana"}


def test_sums_of_days_do_not_depend_on_the_order_in_which_a_database_adds(owner, run, state):
    """PostgreSQL adds rows as they lie, and gives another last digit once they lie otherwise."""
    add_meal(
        state,
        "P002",
        "2026-11-06",
        *(eaten_item(grams, "apple", energy_kcal=grams) for grams in (0.1, 0.2, 0.3)),
        delay=timedelta(seconds=61.2345),
    )
    first = frozen(owner, run, "first")
    with state.database.write() as session:  # moves the row behind the others, and has the day counted anew
        session.execute(sa.update(EffectiveRecord).where(EffectiveRecord.consumed_g == 0.1).values(doubt=0.5))
        session.execute(sa.update(EffectiveRecord).where(EffectiveRecord.consumed_g == 0.1).values(doubt=0.0))
    second = frozen(owner, run, "second")
    assert second["checksum"] == first["checksum"]
    [day] = [row for row in typed(owner, second, "days") if str(row["local_date"]) == "2026-11-06"]
    assert day["consumed_g"] == day["energy_kcal"] == math.fsum([0.1, 0.2, 0.3])
    assert (day["energy_kcal_coverage"], day["median_upload_delay_seconds"]) == (1.0, 61.2345)


def test_later_edits_and_erasures_of_other_days_do_not_change_a_release_and_its_files_are_no_orphans(
    owner, run, state, eaten
):
    release = frozen(owner, run, "late", **{"from": "2026-11-03"})
    before = fetch(owner, release, "items.csv")
    make_old(state.blobs)
    BlobDeleter(state.database, state.blobs).delete_orphans()
    with state.database.write() as session:
        session.execute(sa.update(EffectiveRecord).values(energy_kcal=77.0, status="corrected"))
    add_meal(state, "P002", "2026-11-09", eaten_item(5.0))
    erase(eaten, "two a")
    assert run().outcome == "done"
    assert fetch(owner, release, "items.csv") == before
    assert owner.get(f"{PATH}/late/check").json()["is_whole"] is True
    assert owner.get(f"{PATH}/late").json() == release


def test_filters_choose_days_and_statuses_and_days_need_all_statuses(owner, run):
    release = frozen(owner, run, "early", **{"from": "2026-11-01", "to": "2026-11-02"})
    for table in ("items", "meals", "days", "photographs"):
        assert {row["local_date"] for row in rows(owner, release, table)} == {"2026-11-01", "2026-11-02"}
    some = frozen(owner, run, "rejected", statuses=["rejected"])
    assert {row["status"] for row in rows(owner, some, "items")} == {"rejected"}
    assert not [file for file in some["files"] if file["name"].startswith("days")]


def test_name_is_never_used_twice(owner, run):
    frozen(owner, run, "baseline")
    for _ in range(2):
        assert refusal(owner.post(PATH, json={"name": "baseline"})) == (409, "release_exists")
    for name in ("Base", "a b", "", "x" * 65, "-x"):
        assert refusal(owner.post(PATH, json={"name": name})) == (422, "invalid_input"), name
    answer = owner.post(PATH, json={"name": "other", "from": "2026-11-03", "to": "2026-11-02"})
    assert answer.json()["code"] == "days_reversed"


def test_viewer_downloads_parts_and_what_is_not_there_is_not_found(client, admin, owner, run):
    release = frozen(owner, run, "baseline")
    viewer = make_staff(client, admin, "vera", pilot="viewer")
    part = viewer.get(f"{PATH}/baseline/files/items.csv", headers={"Range": "bytes=2-5"})
    assert (part.status_code, part.content) == (206, fetch(owner, release, "items.csv")[2:6])
    assert [one["name"] for one in viewer.get(PATH).json()["items"]] == ["baseline"]
    for path in ("/baseline/files/nothing.csv", "/other"):
        assert owner.get(PATH + path).status_code == 404


def test_workers_of_0_2_take_no_file_of_a_release_or_an_export_for_an_orphan_and_ours_take_those_that_are(
    owner, run, state
):
    frozen(owner, run, "baseline")
    path = owner.post("/v1/studies/pilot/exports", json={"rows": "meals"}).headers["location"]
    assert run().outcome == "done"
    made = [name for name in stored_names(state.blobs) if "/releases/" in name or "/exports/" in name]
    assert len(made) == 2 * len(TABLES) + 3
    with state.database.read() as session:
        studies = set(map(str, session.scalars(sa.select(Study.id))))
    assert not {name.split("/")[0] for name in made} & studies  # below a study 0.2 deletes what it has no row of
    with state.database.write() as session:
        session.execute(sa.delete(ReleaseFile).where(ReleaseFile.name == "items.csv"))
    make_old(state.blobs)
    assert BlobDeleter(state.database, state.blobs).delete_orphans() == 1
    assert {*made} - {*stored_names(state.blobs)} == {name for name in made if "/items.csv/" in name}
    assert owner.get(path + "/file").status_code == 200


def live_days(owner):
    text = owner.get("/v1/days?study=pilot&format=csv").text
    return [
        {name: value for name, value in row.items() if name not in NOT_DERIVABLE}
        for row in csv.DictReader(io.StringIO(text, newline=""))
    ]


def assert_same_days(found, expected):
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert one.keys() == other.keys()
        for name in one:
            if name in (*HEADLINE_COLUMNS, "consumed_g") or name.endswith("_coverage"):
                assert (one[name] == "") == (other[name] == ""), (name, one, other)
                assert one[name] == "" or float(one[name]) == pytest.approx(float(other[name]), rel=1e-12, abs=1e-15)
            elif name == "median_upload_delay_seconds":
                assert one[name] == other[name] == "" or float(one[name]) == pytest.approx(float(other[name]), abs=2e-3)
            elif name != "study_day":  # stays as it was frozen
                assert one[name] == other[name], (name, one, other)


@pytest.mark.parametrize("erased", [("two a", "closed"), ("two b", "alone", "late")])
def test_release_without_erased_meals_equals_the_studys_current_days_and_a_new_release(
    owner, run, state, eaten, erased
):
    release = frozen(owner, run, "baseline")
    gone = {str(eaten["meals"][meal]) for meal in erased}
    expected = {
        table: [row for row in rows(owner, release, table) if row["meal_id"] not in gone]
        for table in ("items", "meals", "photographs")
    }
    for meal in erased:
        erase(eaten, meal)
    assert refusal(owner.get(f"{PATH}/baseline/files/items.csv")) == (503, "release_changing")
    assert owner.get(f"{PATH}/baseline").json()["state"] == "changing"
    assert run().outcome == "done"
    after = owner.get(f"{PATH}/baseline").json()
    assert (after["state"], after["checksum"] != release["checksum"]) == ("ready", True)
    assert [one["checksum"] for one in after["former_checksums"]] == [release["checksum"]]
    assert after["altered_at"] is not None
    for table, kept in expected.items():
        assert rows(owner, after, table) == kept, table
    assert_same_days(rows(owner, after, "days"), live_days(owner))
    assert owner.get(f"{PATH}/baseline/check").json()["is_whole"] is True
    told = facts(owner, after)
    assert [one["checksum"] for one in told["altered"]] == [release["checksum"]]
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    held = store_bytes(state.blobs)
    for meal_id in gone:
        assert not any(needle in held for needle in (meal_id.encode(), uuid.UUID(meal_id).hex.encode()))
    assert len([name for name in stored_names(state.blobs) if "/releases/" in name]) == len(after["files"])
    with state.database.read() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(ReleaseChange)) == 0
    anew = frozen(owner, run, "anew")
    for file, other in zip(after["files"], anew["files"], strict=True):
        assert file["name"] == "datapackage.json" or file["sha256"] == other["sha256"], file["name"]
    assert after["checksum"] == anew["checksum"]


@pytest.mark.parametrize("policy", ["erase", "anonymise"])
def test_withdrawn_participant_is_in_no_release_by_any_name(client, admin, owner, run, state, eaten, policy):
    profile = {"sex": "male", "birth_year": 1961, "height_cm": 201.5}
    for code in (MARKED, "P002"):
        labels = {"arm": "low salt", "visit": f"{code} at week 4", "excluded": f"{code} moved away"}
        owner.patch(f"/v1/studies/pilot/participants/{code}", json={"profile": profile} | labels).raise_for_status()
    release = frozen(owner, run, "baseline")
    owner.post("/v1/studies/pilot/exports", json={"rows": "items", "filters": {"participant": MARKED}})
    others = {table: [row for row in rows(owner, release, table) if row["participant"] != MARKED] for table in
              ("items", "meals", "days", "photographs", "participants")}  # fmt: skip
    count = {table: len(rows(owner, release, table)) for table in others}
    set_policy(client, admin, withdrawal_policy=policy)
    assert client.post("/v1/me/withdrawal", headers=eaten["phones"][MARKED].headers).status_code == 200
    assert run().outcome == "done"
    after = owner.get(f"{PATH}/baseline").json()
    for table, expected in others.items():
        found = rows(owner, after, table)
        assert [row for row in found if not row["participant"].startswith("withdrawn-")] == expected
        is_kept = policy == "anonymise" and table != "photographs"
        assert len(found) == (count[table] if is_kept else len(expected)), table
    profiles = [(row["sex"], row["height_cm"], row["age_years"]) for row in rows(owner, after, "participants")]
    assert sorted(profiles) == [("", "", "")] * (1 + is_kept) + [("male", "201.5", "65")]
    labels = [(row["arm"], row["visit"], row["excluded"]) for row in rows(owner, after, "participants")]
    kept = ("low salt", "P002 at week 4", "P002 moved away")
    assert sorted(labels) == sorted([("low salt", "", "")] * is_kept + [("", "", "")] + [kept])
    if policy == "anonymise":
        for table in ("items", "meals"):
            key = "id" if table == "items" else "captured_at"
            live = owner.get("/v1/records?study=pilot").json()["items"] if table == "items" else None
            for row in rows(owner, after, table):
                assert row.get("left_received_sha256", "") == "" or not row["participant"].startswith("withdrawn-")
                if live is not None:  # the ids of meals are drawn alike in the study and in its releases
                    [same] = [one for one in live if one[key] == row[key]]
                    assert (same["meal_id"], same["participant"]) == (row["meal_id"], row["participant"])
    else:
        assert {row["food_key"] for row in rows(owner, after, "foods")} == {"apple"}
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    held = store_bytes(state.blobs)
    assert MARKED.lower().encode() not in held
    state.part(LastUse).settle()
    assert state.database.empty_log()
    in_database = database_bytes(state.database)
    assert MARKED.lower().encode() not in in_database  # nor in what exports were asked for, nor in what is to go
    for name, meal in eaten["meals"].items():
        if name not in ("of another", "confirmed empty", "failed", "seen"):
            assert str(meal).encode() not in held + in_database, name
            assert meal.hex.encode() not in in_database, name


def test_second_erasure_during_a_change_is_applied(owner, run, state, eaten, monkeypatch):
    frozen(owner, run, "baseline")
    erase(eaten, "two a")
    hold, done = file_work.hold, []

    def hold_after_another(session, work, claim):
        if not done:
            done.append(True)
            asked = {"deed": "meal", "digest": "0" * 64, "requested_at": datetime.now(UTC)}
            session.add(ReleaseChange(id=uuid.uuid4(), release_id=work.id, **asked))
            session.flush()
        return hold(session, work, claim)

    monkeypatch.setattr(file_work, "hold", hold_after_another)
    assert run().outcome == "again"
    assert owner.get(f"{PATH}/baseline").json()["state"] == "changing"
    assert run().outcome == "done"
    assert owner.get(f"{PATH}/baseline").json()["state"] == "ready"
    assert str(eaten["meals"]["two a"]) not in fetch(owner, {"name": "baseline"}, "meals.csv").decode()


def test_erasure_during_freezing_restarts_the_release(owner, run, state, eaten, monkeypatch):
    owner.post(PATH, json={"name": "baseline"})
    done = []
    write = release_runner.write_files

    def write_after_erasure(*args):
        if not done:
            done.append(True)
            erase(eaten, "two a")
        return write(*args)

    monkeypatch.setattr(release_runner, "write_files", write_after_erasure)
    assert run().outcome in ("again", "lost")
    assert not [name for name in stored_names(state.blobs) if "/releases/" in name]
    assert run().outcome == "done"
    assert str(eaten["meals"]["two a"]) not in fetch(owner, {"name": "baseline"}, "meals.csv").decode()


def test_failed_change_is_retried_without_limit(owner, run, state, eaten, monkeypatch):
    frozen(owner, run, "baseline")
    erase(eaten, "two a")

    def fail(*_):
        raise StorageFullError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(release_runner, "alter_tables", fail)
        begin_now(state)
        assert run().outcome == "again"
        begin_now(state, attempts=5000)  # for weeks
        assert run().outcome == "again"
        begin_now(state)
        assert run().outcome == "again"
    release = owner.get(f"{PATH}/baseline").json()
    assert (release["state"], release["failure"]) == ("changing", "storage_full")
    begin_now(state)
    assert run().outcome == "done"
    assert owner.get(f"{PATH}/baseline").json()["failure"] is None


LOST = {"missing": "release_files_missing", "damaged": "release_files_damaged"}


def lose(state, how):
    """meals.parquet is gone from the store, or another byte stands in its middle. Returns its key and content."""
    [key] = [name for name in stored_names(state.blobs) if "/meals.parquet/" in name]
    content = state.blobs.read(key)
    state.blobs.delete(key)
    if how == "damaged":
        middle = len(content) // 2
        state.blobs.put_bytes(key, content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :])
    return key, content


def begin_now(state, **values):
    with state.database.write() as session:
        session.execute(sa.update(Release).values(begin_after=None, **values))


@pytest.mark.parametrize("how", LOST)
def test_release_with_a_lost_file_fails_with_an_erasure_and_keeps_no_file(owner, run, state, eaten, how):
    frozen(owner, run, "baseline")
    lose(state, how)
    erase(eaten, "two a")
    assert run().outcome == LOST[how]
    release = owner.get(f"{PATH}/baseline").json()
    assert (release["state"], release["failure"]) == ("failed", LOST[how])
    assert owner.get(f"{PATH}/baseline/files/items.csv").json()["code"] == "release_failed"
    assert owner.post(PATH, json={"name": "baseline"}).json()["code"] == "release_exists"
    BlobDeleter(state.database, state.blobs).delete_scheduled()  # what is left of it still holds what was erased
    assert not [name for name in stored_names(state.blobs) if "/releases/" in name]
    with state.database.read() as session:
        for table in (ReleaseFile, ReleaseChange):
            assert session.scalar(sa.select(sa.func.count()).select_from(table)) == 0


def set_policy(client, admin, **policy):
    tag = client.get("/v1/studies/pilot", headers=admin).headers["etag"]
    client.patch("/v1/studies/pilot", headers=admin | {"If-Match": tag}, json=policy).raise_for_status()


def test_places_that_a_study_stops_keeping_stay_in_releases_of_before_which_say_so_and_go_from_all_else(
    client, admin, owner, run, state, eaten
):
    set_policy(client, admin, location_policy="keep")
    add_meal(state, MARKED, "2026-11-07", place={"latitude": 48.1374, "longitude": 11.5755})
    before = frozen(owner, run, "before")
    assert facts(owner, before)["contents"]["placed_meals"] == 1
    assert "48.1374" in fetch(owner, before, "meals.csv").decode()
    paths = {}
    for rows, output in (("meals", "csv"), ("items", "geojson"), ("items", "csv")):
        body = {"rows": rows, "format": output}
        paths[rows, output] = owner.post("/v1/studies/pilot/exports", json=body).headers["location"]
        assert run().outcome == "done"
    set_policy(client, admin, location_policy="drop")
    states = {asked: owner.get(path).json()["state"] for asked, path in paths.items()}
    assert states == {("meals", "csv"): "expired", ("items", "geojson"): "expired", ("items", "csv"): "done"}
    assert owner.get(paths["meals", "csv"] + "/file").json()["code"] == "export_expired"
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    assert len([name for name in stored_names(state.blobs) if "/exports/" in name]) == 1
    assert "48.1374" in fetch(owner, before, "meals.csv").decode()
    after = frozen(owner, run, "after")
    assert facts(owner, after)["contents"]["placed_meals"] == 0
    assert "48.1374" not in fetch(owner, after, "meals.csv").decode()
    set_policy(client, admin, withdrawal_policy="anonymise")
    assert client.post("/v1/me/withdrawal", headers=eaten["phones"][MARKED].headers).status_code == 200
    assert [run().outcome, run().outcome] == ["done", "done"]
    assert facts(owner, before)["contents"]["placed_meals"] == 0
    assert "48.1374" not in fetch(owner, before, "meals.csv").decode()


@pytest.mark.parametrize("what", ["releases", "exports"])
def test_unfinished_file_is_made_again_without_places_once_they_are_dropped(
    client, admin, owner, run, state, what, monkeypatch
):
    set_policy(client, admin, location_policy="keep")
    add_meal(state, "P002", "2026-11-07", place={"latitude": 48.1374, "longitude": 11.5755})
    body = {"name": "baseline"} if what == "releases" else {"rows": "meals", "format": "csv"}
    path = owner.post(f"/v1/studies/pilot/{what}", json=body).headers["location"]
    put, done = state.blobs.put_file, []

    def put_after_change(key, source):
        if not done:
            done.append(True)
            set_policy(client, admin, location_policy="drop")
        put(key, source)

    monkeypatch.setattr(state.blobs, "put_file", put_after_change)
    assert run().outcome == "lost"
    assert owner.get(path).json()["state"] == "queued"
    assert run().outcome == "done"
    made = owner.get(path + ("/files/meals.csv" if what == "releases" else "/file"))
    assert (made.status_code, "48.1374" in made.text) == (200, False)


def test_check_reports_whether_freezing_now_gives_the_same_files_and_which_rows_differ(owner, run, state, eaten):
    frozen(owner, run, "baseline")
    found = compare_release(state.database, state.blobs, "pilot", "baseline")
    assert (found.checked.is_whole, found.is_reproduced) == (True, True)
    assert all(table.is_same and not table.columns for table in found.tables)
    with state.database.write() as session:
        one = session.scalars(sa.select(EffectiveRecord).where(EffectiveRecord.consumed_g == 80.0)).one()
        one.consumed_g, one.flags = 81.0, ["checked"]
    add_meal(state, "P002", "2026-11-09", eaten_item(5.0))
    erase(eaten, "closed")
    assert run().outcome == "done"
    found = compare_release(state.database, state.blobs, "pilot", "baseline")
    assert (found.checked.is_whole, found.is_reproduced) == (True, False)
    items = next(table for table in found.tables if table.table == "items")
    assert (items.same, items.other, items.only_frozen, items.only_now) == (7, 1, 0, 1)
    assert items.columns["consumed_g"] == items.columns["flags"] == items.columns["CA_mg"] == 1  # of grams and content
    assert not {"energy_kcal", "edible_g", "id"} & set(items.columns)  # what the record itself tells is as it was
    assert next(table for table in found.tables if table.table == "meals").only_now == 1


def test_command_reports_a_whole_release_and_names_a_lost_file_by_its_key(owner, run, state):
    def command(*options):
        given = {name: getattr(state.settings, name) for name in state.settings.model_fields_set}
        told = {name: one.get_secret_value() if isinstance(one, SecretStr) else one for name, one in given.items()}
        variables = {f"TADA_{name.upper()}": one for name, one in told.items()}
        return run_tada("releases", "check", "pilot", "baseline", *options, **variables)

    release = frozen(owner, run, "baseline")
    whole = command()
    lines = [f"files: whole, checksum {release['checksum']}", "frozen now, it would be the same"]
    assert (whole.returncode, whole.stdout.splitlines()) == (0, lines)
    key, _ = lose(state, "damaged")
    lost = command()
    assert (lost.returncode, lost.stdout.splitlines()[0]) == (1, f"meals.parquet: damaged, {key}")
    add_meal(state, "P002", "2026-11-09", eaten_item(5.0))
    told = json.loads(command("--json").stdout)
    assert (told["is_whole"], told["is_reproduced"], told["tables"]) == (False, False, None)
    damaged = next(file for file in told["files"] if file["name"] == "meals.parquet")
    assert (damaged["found"], damaged["blob_key"]) == ("damaged", key)
    assert set(damaged) == {"name", "blob_key", "sha256", "found"}
    assert "differences of rows are not shown without its files" in command().stdout


def test_equal_rows_are_compared_by_their_number(owner, run, state, eaten):
    """A study may have measured the same twice: the table of densities has no key."""

    def measure():
        now = datetime.now(UTC)
        values = {"g_per_ml": 0.8, "sd_g_per_ml": 0.1, "state": "raw", "kind": "solid", "weighs": "edible"}
        words = {"source": "a scale", "author": "olga", "reason": "measured"}
        with state.database.write() as session:
            words["study_id"] = session.scalars(sa.select(Study.id).where(Study.code == "pilot")).one()
            times = {"measured_at": now, "created_at": now}
            session.add(StudyDensity(id=uuid.uuid4(), food_key="apple", specimens=None, **values, **words, **times))

    measure()
    measure()
    frozen(owner, run, "baseline")

    def densities():
        tables = compare_release(state.database, state.blobs, "pilot", "baseline").tables
        return next(table for table in tables if table.table == "food_densities")

    assert densities().is_same
    measure()
    assert (densities().only_frozen, densities().only_now) == (0, 1)
