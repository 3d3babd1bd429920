"""A phone's meal that has been estimated."""

from tests.integration.conftest import meal_metadata
from tests.support import estimates
from tests.support.estimates import found_item
from tests.support.photographs import pair

APPLE_HINT = [{"point": [30, 20], "food": "apple"}]


def eaten(phone, state, *items, seed=0, **metadata):
    """A meal that was sent and estimated, of an apple unless told otherwise; its id."""
    body = meal_metadata(**({"hints": APPLE_HINT} | metadata))
    assert phone.post(pair(seed), body).status_code == 202
    estimates.save(state, body["id"], *(items or [found_item()]))
    return body["id"]
