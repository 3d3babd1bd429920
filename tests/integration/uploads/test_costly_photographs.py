"""A photograph that costs a decoder long, beside those of other people: one phone takes no pictures away."""

import io
import threading

import numpy as np
import pytest
from PIL import Image

from app.photos import jpeg
from tests.integration.conftest import meal_metadata
from tests.integration.uploads.answers import refusal
from tests.support.photographs import pair, photograph

SIDE_PX, SCANS = 5000, 1200


@pytest.fixture
def settings(settings):
    return settings.model_copy(update={"max_photo_pixels": 60_000_000})


def costly_photograph():
    """A progressive JPEG whose last scan is repeated: a pass over all pixels each time."""
    stream = io.BytesIO()
    Image.fromarray(np.full((SIDE_PX, SIDE_PX, 3), 128, np.uint8)).save(stream, "JPEG", progressive=True)
    whole = stream.getvalue()
    return whole[:-2] + whole[whole.rindex(b"\xff\xda") : -2] * SCANS + b"\xff\xd9"


def sent(phone, photos):
    body = meal_metadata()
    answer = phone.post(photos, metadata=body)
    assert answer.status_code == 202, answer.text
    return f"/v1/meals/{body['id']}/images/left"


@pytest.mark.slow
def test_costly_photograph_is_refused_at_upload_and_would_take_no_picture_of_another_study_away(enrol, monkeypatch):
    """Four requests of one at once left six of seven pictures of another study with 503.

    It was sealed before scans were limited.
    """
    attacker, others = enrol("P001", "pilot"), enrol("P001", "other")
    photos = {"left": costly_photograph(), "right": photograph(1)}
    assert refusal(attacker.post(photos)) == (422, "image_unreadable")
    monkeypatch.setattr(jpeg, "MAX_SCANS", 10 * SCANS)
    monkeypatch.setattr(jpeg, "MAX_SCAN_PIXELS", 10 * SCANS * SIDE_PX**2)
    costly = sent(attacker, photos)
    pictures = [sent(others, pair()) for _ in range(7)]
    statuses = []
    attack = [threading.Thread(target=lambda: statuses.append(attacker.get(costly).status_code)) for _ in range(4)]
    for thread in attack:
        thread.start()
    try:
        assert [others.get(picture).status_code for picture in pictures] == [200] * 7
    finally:
        for thread in attack:
            thread.join(120)
    assert set(statuses) <= {200, 422, 503}
