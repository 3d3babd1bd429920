"""Measured densities over HTTP: a food's, and a study's own."""

import pytest

from tests.integration.foods.editing import refused


def specimens_of(*pairs):
    return [{"volume_ml": volume_ml, "mass_g": mass_g} for volume_ml, mass_g in pairs]


def test_a_study_s_own_density_goes_first_there_and_nowhere_else(staff, enrol):
    phone, other = enrol("P001", "pilot"), enrol("P002", "second")
    body = {"food": "09003", "g_per_ml": 0.7, "sd_g_per_ml": 0.02, "state": "raw", "kind": "solid"}
    body |= {"method": "water displacement", "reason": "our cultivar"}
    made = staff.post("/v1/studies/pilot/densities", body)
    assert made.status_code == 201, made.json()
    assert made.json()["food"] == "apple"
    staff.patch("apple", name="ours")  # its key stays
    chosen = phone.get("/v1/foods/apple").json()["density"]["chosen"]
    assert (chosen["g_per_ml"], chosen["basis"]) == (0.7, "study")
    assert other.get("/v1/foods/apple").json()["density"]["chosen"]["basis"] == "measured"
    assert staff.get("/v1/foods/apple").json()["density"]["chosen"]["basis"] == "measured"
    path = f"/v1/studies/pilot/densities/{made.json()['id']}/withdrawal"
    refused(staff.post(path.replace("pilot", "second"), {"reason": "not ours"}), 404, "density_not_found")
    withdrawn = staff.post(path, {"reason": "scale was off"})
    assert withdrawn.json()["withdrawal_reason"] == "scale was off"
    refused(staff.post(path, {"reason": "again"}), 409, "density_withdrawn")
    assert phone.get("/v1/foods/apple").json()["density"]["chosen"]["basis"] == "measured"
    listed = staff.get("/v1/studies/pilot/densities?food=apple").json()["items"]
    assert [row["withdrawn_by"] for row in listed] == ["staff: admin"]
    assert staff.get("/v1/studies/second/densities").json() == {"items": []}


def test_a_density_that_cannot_be_is_refused_and_specimens_of_one_that_can_are_kept(staff, enrol):
    enrol()
    path, body = "/v1/studies/pilot/densities", {"food": "apple", "state": "raw", "kind": "solid", "method": "m"}
    body |= {"reason": "r"}
    sound = {"g_per_ml": 1.0, "sd_g_per_ml": 0.1}
    for change in (
        {"g_per_ml": 0.7},
        {"specimens": []},
        {"specimens": specimens_of((1, 1))},
        {"specimens": specimens_of((0, 1)) * 2},
        {"specimens": specimens_of((1e6, 1e-320)) * 2},
        {"specimens": specimens_of((100, 1), (100, 290), (100, 9))},
        {"specimens": specimens_of((1, 1)) * 2, "volume_step_ml": 100},
        sound | {"specimens": specimens_of((10, 9)) * 2},
        sound | {"g_per_ml": 0.1, "sd_g_per_ml": 0.2},
        sound | {"g_per_ml": 9.0},
        sound | {"sd_g_per_ml": -0.1},
        sound | {"kind": "fluffy"},
        sound | {"measured_at": "2999-01-01T00:00:00Z"},
        sound | {"measured_at": "2026-01-01T00:00:00"},
        sound | {"g_per_ml": True},
    ):
        assert staff.post(path, body | change).status_code == 422, change
    assert staff.get(path).json() == {"items": []}
    specimens = specimens_of((200.0, 168.0), (250.0, 204.0))
    made = staff.post(path, body | {"specimens": specimens, "measured_at": "2026-11-20T12:00:00+08:00"}).json()
    assert made["specimens"] == specimens
    assert made["g_per_ml"] == pytest.approx((0.84 + 0.816) / 2)
    assert made["measured_at"] == "2026-11-20T04:00:00Z"
