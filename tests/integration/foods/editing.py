"""A food to make, and what an admin's refused call looks like."""

QUARK = {
    "key": "quark-low-fat",
    "name": "Quark, low fat",
    "group": "Dairy and Egg Products",
    "form": "in_vessel",
    "state": "as_eaten",
    "nutrients": {
        "ENERC_KCAL": {"per_100_g": 67, "unit": "kcal"},
        "PROCNT": {"per_100_g": 12.5, "unit": "g"},
        "CA": {"per_100_g": 0.12, "unit": "g"},
    },
    "densities": [
        {"g_per_ml": 1.05, "sd_g_per_ml": 0.03, "state": "as sold", "kind": "bulk", "source": "weighed in a cup"}
    ],
    "reason": "Asked for by the pilot study",
}


def refused(answer, status, code):
    body = answer.json()
    assert (answer.status_code, body["code"]) == (status, code), body
    assert len(body["detail"]) > 20
    return body
