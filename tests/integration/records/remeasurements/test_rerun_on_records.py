"""What a new run on kept photographs means for a meal: its items, people's events, and when the old run stays."""

import pytest
import sqlalchemy as sa

from app.children.faults import JOB_GAVE_UP
from app.meals.stored.job_models import Job
from app.meals.stored.record_models import EffectiveRecord, Item, Run
from app.records.recompute_records import rebuild_records
from tests.integration.conftest import meal_metadata
from tests.integration.people.people import make_staff
from tests.integration.records.after_pairs import RED, YELLOW, Table, left_of_apple
from tests.integration.records.remeasurements.measuring_again import Again
from tests.integration.records.reviewing import Speaker, new_event
from tests.support import estimates
from tests.support.estimates import found_item
from tests.support.photographs import pair

APPLE = [[10.0, 10.0], [50.0, 10.0], [50.0, 50.0], [10.0, 50.0]]
BANANA = [[100.0, 10.0], [150.0, 10.0], [150.0, 50.0], [100.0, 50.0]]
PEAR = [[200.0, 10.0], [250.0, 10.0], [250.0, 50.0], [200.0, 50.0]]
HINTS = [{"point": [30, 20], "food": "apple"}, {"point": [120, 20], "food": "banana"}]
NO_MARKER = {"failure": {"code": "marker_not_found", "message": "No marker.", "advice": "Lay it flat."}}


def moved(ring, by=4.0):
    """A ring that a newer pipeline draws a little elsewhere."""
    return [[x + by, y] for x, y in ring]


def apple(volume_ml=185.0, polygon=APPLE, **changes):
    return found_item(volume_ml, hint=0, polygon=polygon, **changes)


def banana(volume_ml=90.0, polygon=BANANA, **changes):
    return found_item(volume_ml, hint=1, polygon=polygon, **changes)


def pear(volume_ml=120.0):
    return found_item(volume_ml, hint=None, polygon=PEAR)


@pytest.fixture
def again(client, admin, state, phone):
    return Again(client, admin, state)


@pytest.fixture
def participant(client, phone, state):
    body = meal_metadata(hints=HINTS)
    phone.post(pair(), body)
    estimates.save(state, body["id"], apple(), banana())
    return Speaker(client, phone.headers, body["id"])


@pytest.fixture
def reviewer(client, admin, participant):
    staff = make_staff(client, admin, "keller", pilot="reviewer")
    return Speaker(client, staff.headers, participant.meal_id)


@pytest.fixture(autouse=True)
def records_follow_from_runs_and_events(state):
    """Whatever was measured again: a rebuild finds nothing to put right."""
    yield
    assert rebuild_records(state.database, write=False).different == 0


def standing(participant):
    return [item for item in participant.meal()["items"] if not {"replaced", "undone"} & set(item["flags"])]


def volumes(participant):
    return {item["food"]["key"]: item["volume_ml"] for item in standing(participant) if item["food"] is not None}


def remeasured(again, participant, *items, **changes):
    """The meal measured again with this answer: (numbers, rows)."""
    return again.done({(participant.meal_id, "rerun"): changes or list(items)})


def test_items_keep_their_ids_and_get_the_new_outline_volume_and_grams(again, participant, state):
    def first_rows():
        with state.database.read() as session:
            return [(item.id, item.rings, item.volume_ml) for item in session.scalars(sa.select(Item))]

    before, rows_before = participant.items(), first_rows()
    numbers, rows = remeasured(again, participant, banana(91.0), apple(200.0, moved(APPLE), flags=["small_baseline"]))
    after = participant.items()
    assert first_rows() == rows_before
    assert [item["id"] for item in after] == [item["id"] for item in before]
    assert volumes(participant) == {"apple": 200.0, "banana": 91.0}
    assert (after[0]["polygon"], after[0]["flags"]) == ([moved(APPLE)], ["small_baseline"])
    assert after[0]["mass_g"] == pytest.approx(before[0]["mass_g"] * 200.0 / 185.0)
    assert (numbers["measured"], numbers["kept"], numbers["items"], numbers["items_changed"]) == (1, 0, 2, 2)
    row = next(row for row in rows if row["food"] == "apple")
    assert (row["old_volume_ml"], row["old_low_ml"], row["new_volume_ml"]) == (185.0, 166.5, 200.0)
    assert (row["new_low_ml"], row["new_high_ml"]) == (180.0, pytest.approx(220.0))
    assert (row["old_mass_g"], row["new_mass_g"]) == (before[0]["mass_g"], after[0]["mass_g"])
    with state.database.read() as session:
        runs = session.scalars(sa.select(Run).order_by(Run.created_at)).all()
        assert {record.run_id for record in session.scalars(sa.select(EffectiveRecord))} == {runs[-1].id}
        assert {job.turn for job in session.scalars(sa.select(Job).where(Job.is_background))} == {0}
    assert [run.purpose for run in runs] == ["meal", "meal"]
    assert str(runs[-1].remeasurement_id) == numbers["id"]


def test_same_answer_changes_no_figure_and_a_second_time_neither(again, participant, phone):
    answer = (apple(), banana())
    before = phone.get("/v1/records").json()["items"]
    for _ in range(2):
        numbers, rows = remeasured(again, participant, *answer)
        assert (numbers["items"], numbers["items_changed"]) == (2, 0)
        assert not any(row["is_changed"] for row in rows)
    after = phone.get("/v1/records").json()["items"]
    unseen = {"change_seq"}
    assert [{k: v for k, v in row.items() if k not in unseen} for row in after] == [
        {k: v for k, v in row.items() if k not in unseen} for row in before
    ]


def test_what_people_said_stays_on_top_of_the_new_volumes_and_undone_it_is_the_new_runs(again, participant, reviewer):
    first, second = participant.items()
    volume = new_event("set_volume", item=first["id"], volume_ml=150.0)
    assert participant.send(volume).status_code == 201
    participant.say("set_share", item=first["id"], share=0.5)
    participant.say("confirm", item=second["id"])
    reviewer.say("set_food", item=first["id"], food="pear")
    reviewer.say("set_mass", item=second["id"], mass_g=77.0)
    _, rows = remeasured(again, participant, apple(200.0), banana(300.0))
    first, second = participant.items()
    assert (first["food"]["key"], first["share"], first["volume_ml"]) == ("pear", 0.5, 150.0)
    assert (second["mass_g"], second["status"], second["volume_ml"]) == (77.0, "corrected", 300.0)
    assert len(participant.history()["items"]) == 5
    row = next(row for row in rows if row["item_id"] == first["id"])
    assert (row["old_volume_ml"], row["new_volume_ml"]) == (185.0, 200.0)
    assert row["old_mass_g"] == row["new_mass_g"]
    participant.say("undo", event=volume["id"])
    assert participant.items()[0]["volume_ml"] == 200.0


def test_redrawn_region_keeps_its_own_measurement(again, participant, state):
    first, _ = participant.items()
    participant.say("redraw", item=first["id"], polygon=PEAR)
    drawn = found_item(240.0, hint=0, polygon=PEAR)
    estimates.save(state, participant.meal_id, drawn, purpose="remeasure", regions=[first["id"]])
    assert participant.items()[0]["volume_ml"] == 240.0
    numbers, _ = remeasured(again, participant, apple(200.0), banana())
    assert (numbers["measured"], participant.items()[0]["volume_ml"]) == (1, 240.0)
    assert participant.items()[0]["polygon"] == [PEAR]


def test_items_that_nobody_spoke_of_are_replaced_by_those_of_the_new_run(again, participant, phone):
    first, second = participant.items()
    participant.say("confirm", item=first["id"])
    numbers, rows = remeasured(again, participant, apple(200.0), pear())
    assert (numbers["measured"], numbers["items"]) == (1, 3)
    assert [item["volume_ml"] for item in standing(participant)] == [200.0, 120.0]
    gone = next(item for item in participant.meal()["items"] if item["id"] == second["id"])
    assert (gone["status"], gone["flags"], gone["consumed_g"]) == ("rejected", ["replaced"], None)
    assert participant.refused("confirm", item=second["id"]) == (409, "item_replaced")
    by_id = {row["item_id"]: row for row in rows}
    assert by_id[second["id"]]["new_volume_ml"] is None
    new = next(row for row in rows if row["old_volume_ml"] is None)
    assert new["new_volume_ml"] == 120.0
    numbers, _ = remeasured(again, participant, apple(200.0), pear())  # the replaced one stays gone
    assert (numbers["items"], numbers["items_changed"]) == (2, 0)


@pytest.mark.parametrize(
    ("say", "answer"),
    [
        (lambda s: s.say("confirm", item=s.items()[1]["id"]), [apple(200.0)]),
        (lambda s: s.say("set_mass", item=s.items()[1]["id"], mass_g=50.0), [apple(), pear()]),
        (lambda s: s.say("comment", item=s.items()[1]["id"], text="Half ripe."), [apple()]),
        (lambda s: s.say("confirm_meal"), [apple(), banana(), pear()]),
        (lambda s: s.say("add", food="pear", amount={"mass_g": 90.0}), [apple(), banana(), pear()]),
        (lambda s: s.say("merge", items=[item["id"] for item in s.items()], food="pear"), [apple()]),
        (lambda s: s.say("split", item=s.items()[0]["id"], parts=[{"share": 0.3}, {"share": 0.7}]), [banana()]),
    ],
)
def test_old_run_is_kept_where_a_persons_statement_would_lose_what_it_refers_to(again, participant, say, answer):
    say(participant)
    before = participant.meal()
    numbers, rows = remeasured(again, participant, *answer)
    assert (numbers["kept"], numbers["reasons"], numbers["items"]) == (1, {"other_items": 1}, 0)
    assert participant.meal() == before
    (row,) = rows
    assert (row["state"], row["reason"], row["item_id"]) == ("kept", "other_items", None)


@pytest.mark.parametrize("answer", [[apple(), banana(95.0)], [banana(95.0)]])
def test_item_that_a_person_rejected_stays_rejected_whether_it_is_seen_again_or_not(again, participant, answer):
    first, _ = participant.items()
    participant.say("reject", item=first["id"])
    numbers, _ = remeasured(again, participant, *answer)
    assert numbers["measured"] == 1
    first, second = participant.items()
    assert (first["status"], second["volume_ml"]) == ("rejected", 95.0)


def test_run_that_fails_is_kept_beside_the_old_one_and_a_job_without_a_run_leaves_its_reason(again, participant, state):
    before = participant.meal()
    numbers, _ = remeasured(again, participant, **NO_MARKER)
    assert numbers["reasons"] == {"marker_not_found": 1}
    assert participant.meal() == before
    with state.database.read() as session:
        assert [run.purpose for run in session.scalars(sa.select(Run).order_by(Run.created_at))] == ["meal", "rerun"]
    started = again.start()
    assert again.feed(1) == 1
    again.fail(JOB_GAVE_UP)
    assert again.feed(1) == 0
    numbers = again.get(started["id"]).json()
    assert (numbers["state"], numbers["reasons"]) == ("done", {"job_gave_up": 1})
    assert participant.meal() == before


def test_failed_meal_that_is_measured_now_has_items_and_no_failure(again, client, phone, state):
    body = meal_metadata(hints=HINTS)
    phone.post(pair(), body)
    estimates.save(state, body["id"], **NO_MARKER)
    participant = Speaker(client, phone.headers, body["id"])
    assert participant.meal()["status"] == "failed"
    numbers, _ = remeasured(again, participant, apple(), banana())
    meal = participant.meal()
    assert (numbers["measured"], meal["status"], meal["failure"]) == (1, "estimated", None)
    assert volumes(participant) == {"apple": 185.0, "banana": 90.0}


def test_what_was_left_is_measured_again_too_and_stays_with_its_food(again, client, phone, state):
    def seen(x, lab, volume_ml, polygon, hint=None):
        return estimates.seen_item(x, 100, lab, volume_ml, hint, polygon=polygon)

    table = Table(phone, state).measured(seen(-60, RED, 185.0, APPLE, 0), seen(50, YELLOW, 155.0, BANANA, 1))
    table.send_after().after_measured(left_of_apple(100.0, polygon=APPLE))
    (piece,) = table.after["leftovers"]
    reviewer = Speaker(client, again.headers, table.id)
    reviewer.say("set_leftover", item=piece["id"], of=piece["item"], **{"class": "refuse"})
    numbers, rows = again.done(
        {
            (table.id, "rerun"): [seen(-60, RED, 190.0, APPLE, 0), seen(50, YELLOW, 155.0, BANANA, 1)],
            (table.id, "rerun_after"): [left_of_apple(110.0, polygon=APPLE)],
        }
    )
    (now,) = table.after["leftovers"]
    assert (now["id"], now["item"], now["class"], now["volume_ml"]) == (piece["id"], piece["item"], "refuse", 110.0)
    assert (numbers["pairs"], numbers["measured"], numbers["items"]) == (2, 2, 3)
    assert [row["pair"] for row in rows] == ["meal", "meal", "after"]
    numbers, _ = again.done(
        {
            (table.id, "rerun"): [seen(-60, RED, 190.0, APPLE, 0), seen(50, YELLOW, 155.0, BANANA, 1)],
            (table.id, "rerun_after"): {"failure": {"code": "no_food_found", "message": "-", "advice": "-"}},
        }
    )
    assert numbers["reasons"] == {"other_items": 1}  # a reviewer spoke of the piece
    assert table.after["leftovers"] == [now]


@pytest.mark.both_stores
def test_pair_that_is_to_be_measured_by_its_own_job_is_not_touched(again, client, phone, state, admin):
    body = meal_metadata(hints=HINTS)
    phone.post(pair(), body)
    estimates.save(state, body["id"], **NO_MARKER)
    started = again.start()
    assert again.feed(1) == 1
    assert client.post(f"/v1/meals/{body['id']}/retry", headers=admin).status_code in (200, 202)
    estimates.save(state, body["id"], apple(), purpose="rerun")
    numbers = again.get(started["id"]).json()
    assert numbers["reasons"] == {"waits_for_estimate": 1}
    assert client.get(f"/v1/meals/{body['id']}", headers=admin).json()["status"] == "queued"
