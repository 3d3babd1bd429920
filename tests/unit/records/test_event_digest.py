"""The stored digest of an event: an event sent before an upgrade and again after it must be the same event."""

import pytest
from pydantic import TypeAdapter

from app.records.review.meal_events import content_sha256
from app.records.review.schemas import EventIn

ITEM = "41aedb34-b4e0-4fb3-82ca-8bbb927a9914"
EVENT = "0d9ad0a5-93ce-4f0f-8f39-4f1f1d1b7f6e"
FORM = {
    "section": "slab",
    "centre_mm": [1.5, -20],
    "length_mm": 100,
    "width_mm": 60,
    "height_mm": 30,
    "yaw_deg": 15,
}
DIGESTS = [  # as computed by the program that was first to store them
    (
        {"kind": "confirm", "item": ITEM},
        "ce40cea182043e3495862b23761632d33ec874e03dae282e9fb24db5a5bc5055",
    ),
    (
        {"kind": "set_mass", "item": ITEM, "mass_g": 120.5},
        "74fff275b7e4d6e9fd20b17186898f57b740df8637a62788c675077d9758257e",
    ),
    (
        {"kind": "set_volume", "item": ITEM, "volume_ml": 250.0},
        "159d3a973f775272b64068db65a6c6ce0c42919e15e5eac76b921a6ce3d128f0",
    ),
    (
        {"kind": "set_food", "item": ITEM, "food": "apple"},
        "04193353dbb2b0fe8eea09bd6e51c4bc5e0cc6e56beec4eff63b5ea5e741d9a9",
    ),
    (
        {"kind": "split", "item": ITEM, "parts": [{"share": 0.5}, {"share": 0.5}]},
        "1ccd7d7462376fd7aefae1a92ee050b897cf41f3270f687ef367eee2caf7d95b",
    ),
    (
        {"kind": "comment", "text": "Ä salad"},
        "bab59798734966d2ca8ecd1784a7d3d63acc575bc818d758d287bd70ebc5d8a6",
    ),
    (
        {"kind": "reshape", "item": ITEM, "form": FORM},
        "49a4301a22ba63dd9a55954e8d559f15d9115c5832a31427441130e77b5f6efd",
    ),
    ({"kind": "confirm_meal"}, "48f1e165eda43bde63580a3ca36039de9f788b497bab61cf1af9b774455710e7"),
    ({"kind": "undo", "event": EVENT}, "693abee5d543c6fc667d0418de82bead2e3855e99a80170842026bd6e4ff4957"),
]


@pytest.mark.parametrize(("body", "digest"), DIGESTS, ids=[body["kind"] for body, _ in DIGESTS])
def test_digest_of_an_event_is_the_stored_one(body, digest):
    assert content_sha256(TypeAdapter(EventIn).validate_python({"id": EVENT, **body})) == digest
