"""The stored digest of an event: an event sent before an upgrade and again after it must be the same event."""

import pytest
from pydantic import TypeAdapter

from app.records.review.meal_events import content_sha256
from app.records.review.schemas import EventIn

ITEM = "41aedb34-b4e0-4fb3-82ca-8bbb927a9914"
EVENT = "0d9ad0a5-93ce-4f0f-8f39-4f1f1d1b7f6e"
FORM = {"section": "slab", "centre_mm": [1.5, -20], "length_mm": 100, "width_mm": 60, "height_mm": 30, "yaw_deg": 15}
DIGESTS = [  # their beginnings, as computed by the program that was first to store them
    ({"kind": "confirm", "item": ITEM}, "ce40cea182043e34"),
    ({"kind": "set_mass", "item": ITEM, "mass_g": 120.5}, "74fff275b7e4d6e9"),
    ({"kind": "set_volume", "item": ITEM, "volume_ml": 250.0}, "159d3a973f775272"),
    ({"kind": "set_food", "item": ITEM, "food": "apple"}, "04193353dbb2b0fe"),
    ({"kind": "split", "item": ITEM, "parts": [{"share": 0.5}, {"share": 0.5}]}, "1ccd7d7462376fd7"),
    ({"kind": "comment", "text": "Ä salad"}, "bab59798734966d2"),
    ({"kind": "reshape", "item": ITEM, "form": FORM}, "49a4301a22ba63dd"),
    ({"kind": "confirm_meal"}, "48f1e165eda43bde"),
    ({"kind": "undo", "event": EVENT}, "693abee5d543c6fc"),
]


@pytest.mark.parametrize(("body", "digest"), DIGESTS, ids=[body["kind"] for body, _ in DIGESTS])
def test_digest_of_an_event_is_the_stored_one(body, digest):
    found = content_sha256(TypeAdapter(EventIn).validate_python({"id": EVENT, **body}))
    assert (found[:16], len(found)) == (digest, 64)
