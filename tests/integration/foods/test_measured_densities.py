"""Measured densities over HTTP: a food's, and a study's own."""

import pytest

from tests.integration.foods.editing import refused


def test_a_measured_density_goes_before_the_tables(staff):
    specimens = [{"volume_ml": 200, "mass_g": 168}, {"volume_ml": 250, "mass_g": 204}, {"volume_ml": 100, "mass_g": 82}]
    body = {
        "specimens": specimens,
        "volume_step_ml": 10,
        "state": "raw, whole",
        "kind": "solid",
        "method": "water",
        "reason": "r",
    }
    made = staff.post("/v1/foods/apple/densities", body)
    assert made.status_code == 201, made.json()
    chosen = made.json()["density"]["chosen"]
    assert (chosen["g_per_ml"], chosen["basis"], chosen["source"]) == (0.82, "measured", "water: median of 3 specimens")
    assert chosen["sd_g_per_ml"] == pytest.approx(10 / 12**0.5 / (550 / 3) * 0.82)


def test_a_study_s_own_density_goes_first_there_and_nowhere_else(staff, enrol):
    phone, other = enrol("P001", "pilot"), enrol("P002", "second")
    body = {"food": "09003", "g_per_ml": 0.7, "sd_g_per_ml": 0.02, "state": "raw", "kind": "solid"}
    body |= {"method": "water displacement", "reason": "our cultivar"}
    made = staff.post("/v1/studies/pilot/densities", body)
    assert made.status_code == 201, made.json()
    assert made.json()["food"] == "apple"
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


def test_specimens_of_a_study_s_density_are_kept(staff, enrol):
    enrol()
    specimens = [{"volume_ml": 200.0, "mass_g": 168.0}, {"volume_ml": 250.0, "mass_g": 204.0}]
    body = {"food": "apple", "specimens": specimens, "state": "raw", "kind": "solid", "method": "m", "reason": "r"}
    made = staff.post("/v1/studies/pilot/densities", body | {"measured_at": "2026-11-20T12:00:00+08:00"}).json()
    assert made["specimens"] == specimens
    assert made["g_per_ml"] == pytest.approx((0.84 + 0.816) / 2)
    assert made["measured_at"] == "2026-11-20T04:00:00Z"


@pytest.mark.parametrize(
    "change",
    [
        {"g_per_ml": 0.7},
        {"sd_g_per_ml": 0.1},
        {"specimens": []},
        {"specimens": [{"volume_ml": 1, "mass_g": 1}]},
        {"specimens": [{"volume_ml": 10, "mass_g": 100}] * 2},
        {"specimens": [{"volume_ml": 0, "mass_g": 1}] * 2},
        {"specimens": [{"volume_ml": 1e6, "mass_g": 1e-320}] * 2},
        {"specimens": [{"volume_ml": 1e6, "mass_g": 0.01}] * 2},
        {
            "specimens": [
                {"volume_ml": 100, "mass_g": 1},
                {"volume_ml": 100, "mass_g": 290},
                {"volume_ml": 100, "mass_g": 9},
            ]
        },
        {"specimens": [{"volume_ml": 1, "mass_g": 1}] * 2, "volume_step_ml": 100},
        {"g_per_ml": 0.1, "sd_g_per_ml": 0.2},
        {"g_per_ml": 1e-320, "sd_g_per_ml": 0.0},
        {"specimens": [{"volume_ml": 10, "mass_g": 9}] * 2, "g_per_ml": 1.0, "sd_g_per_ml": 0.1},
        {"g_per_ml": 9.0, "sd_g_per_ml": 0.1},
        {"g_per_ml": 1.0, "sd_g_per_ml": -0.1},
        {"g_per_ml": 1.0, "sd_g_per_ml": 0.1, "kind": "fluffy"},
        {"g_per_ml": 1.0, "sd_g_per_ml": 0.1, "measured_at": "2999-01-01T00:00:00Z"},
        {"g_per_ml": 1.0, "sd_g_per_ml": 0.1, "measured_at": "2026-01-01T00:00:00"},
        {"g_per_ml": True, "sd_g_per_ml": 0.1},
        {"g_per_ml": "1", "sd_g_per_ml": 0.1},
    ],
)
def test_a_density_that_cannot_be_is_refused(staff, enrol, change):
    enrol()
    body = {"food": "apple", "state": "raw", "kind": "solid", "method": "m", "reason": "r"} | change
    assert staff.post("/v1/studies/pilot/densities", body).status_code == 422
    assert staff.get("/v1/studies/pilot/densities").json() == {"items": []}
