"""The pages of remeasurements: figures and files are the API's; owners count, start, stop and continue."""

import pytest

from tests.integration.conftest import meal_metadata
from tests.integration.dashboard.conftest import figures_of, text_of
from tests.integration.records.remeasurements.measuring_again import PATH as API
from tests.integration.records.remeasurements.measuring_again import Again
from tests.support import estimates
from tests.support.estimates import found_item

PATH = "/dashboard/studies/pilot/remeasurements"
PLAN = "/dashboard/studies/pilot/remeasurement-plan"


@pytest.fixture
def again(client, admin, state):
    return Again(client, admin, state)


@pytest.fixture
def meals(phone, client, meal_of):
    """Two measured meals, and one that was never photographed."""
    told = meal_metadata(items=[{"food": "apple"}], captured_at="2026-11-20T18:00:00+08:00")
    assert client.post("/v1/declared-meals", headers=phone.headers, json=told).status_code == 201
    return [meal_of(found_item(), captured_at=f"2026-11-20T{hour}:30:00+08:00") for hour in ("08", "12")]


def test_owner_counts_starts_stops_and_continues(owner, again, meals):
    counted = text_of(owner.page(PLAN, limit="1"))
    assert "Of 1 pairs of photographs 1 would be measured" in counted
    counted = text_of(owner.page(PLAN, limit=""))
    assert "Of 3 pairs of photographs 2 would be measured" in counted
    assert "1 skipped: no photographs" in counted
    assert again.client.get(API, headers=again.headers).json()["items"] == []
    answer = owner.post(PATH, limit="")
    assert answer.status_code == 303
    run = answer.headers["location"]
    assert f'hx-get="{run}/state"' in owner.page(run)
    refused = owner.post(PATH, limit="1")
    assert refused.status_code == 409
    assert "Another remeasurement of this study is running" in refused.text
    assert owner.post(f"{run}/stop").headers["location"] == run
    assert "hx-get" not in (stopped := owner.page(run))
    assert "Continue" in stopped
    assert owner.post(f"{run}/continue").status_code == 303
    again.measure({(meal, "rerun"): [found_item(200.0)] for meal in meals})
    fragment = owner.get(f"{run}/state", headers={"HX-Request": "true"})
    assert fragment.headers["hx-redirect"] == run
    assert owner.post(f"{run}/stop").status_code == 409


def test_figures_and_file_are_the_apis(owner, again, meals):
    numbers, rows = again.done({(meal, "rerun"): [found_item(200.0)] for meal in meals})
    run = f"{PATH}/{numbers['id']}"
    shown = figures_of(owner.page(run))
    progress = [numbers[name] for name in ("measured", "kept", "skipped", "items_changed")]
    assert shown[:4] == progress
    assert shown[4:5] == [numbers["reasons"]["no_photographs"]]
    compared = []
    for row in rows:
        if row["item_id"] is not None:
            old, new = row["old_volume_ml"], row["new_volume_ml"]
            compared += [old, row["old_low_ml"], row["old_high_ml"], new, row["new_low_ml"], row["new_high_ml"]]
            compared += [new / old - 1, row["old_mass_g"], row["new_mass_g"]]
    assert shown[5:] == pytest.approx(compared)
    listed = figures_of(owner.page(PATH))
    names = ("pairs", "measured", "kept", "skipped", "items_changed", "items")
    assert listed == [numbers[name] for name in names]
    for output in ("csv", "ndjson"):
        assert owner.get(f"{run}/items", format=output).text == again.get(numbers["id"], "/items", format=output).text


def test_progress_is_shown_while_it_is_running_and_a_viewer_finds_no_control(again, meals, sign_in_browser):
    started = again.start()
    again.feed(1)
    estimates.save(again.state, meals[0], found_item(200.0), purpose="rerun")
    viewer = sign_in_browser("vera", pilot="viewer")
    run = f"{PATH}/{started['id']}"
    fragment = viewer.get(f"{run}/state", headers={"HX-Request": "true"})
    assert "1 of 3 pairs are done" in text_of(fragment.text)
    assert 'hx-trigger="every 4s"' in fragment.text
    for path in (PATH, run):
        assert 'method="post" action="/dashboard/studies' not in viewer.page(path)


def test_limit_that_is_none_is_told_beside_its_field(owner, again):
    for limit in ("0", "many", "1.5"):
        answer = owner.post(PATH, limit=limit)
        assert answer.status_code == 422
        assert 'id="limit-wrong"' in answer.text
    assert again.client.get(API, headers=again.headers).json()["items"] == []
