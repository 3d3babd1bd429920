"""GET /v1/meals/{id}/images/{slot}: seen upright and without metadata, by whom it may be, and each reading is noted."""

import io
import uuid
from datetime import UTC, datetime

import numpy as np
import pytest
import sqlalchemy as sa
from PIL import Image

from app.meals.estimate.estimate_json import colour_to_json
from app.meals.stored.models import Meal, MealImage
from app.people.privacy_models import AuditEvent
from app.vision.model import ColourCorrection
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.integration.records.after_pairs import Table, apple
from tests.support import estimates
from tests.support.photographs import pair, photograph
from tests.support.stores import damage


def sent(phone, photos=None, **metadata):
    body = meal_metadata(**metadata)
    answer = phone.post(photos or pair(), metadata=body)
    assert answer.status_code == 202, answer.text
    return f"/v1/meals/{body['id']}/images"


def readings(state):
    with state.database.read() as session:
        return list(session.scalars(sa.select(AuditEvent).where(AuditEvent.action == "photograph.read")))


def opened(answer):
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "image/jpeg"
    return Image.open(io.BytesIO(answer.content))


def turned_photograph():
    """Stored on its side with what phones write into EXIF: a red patch that is at the top left once it is upright."""
    pixels = np.full((480, 640, 3), 200, np.uint8)
    pixels[-200:, :200] = (255, 0, 0)  # bottom left as stored; orientation 6 turns it clockwise
    exif = Image.Exif()
    exif[0x0112] = 6
    exif[0x010F] = "a maker"
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", exif=exif)
    return buffer.getvalue()


def test_photograph_is_upright_without_metadata_and_the_reading_is_noted_by_alias(phone, state):
    path = sent(phone, {"left": turned_photograph(), "right": photograph(1)})
    picture = opened(phone.get(f"{path}/left"))
    assert picture.size == (480, 640)
    assert not picture.getexif()
    red, green, _ = picture.getpixel((60, 60))
    assert red > 200
    assert green < 60
    (event,) = readings(state)
    with state.database.read() as session:
        meal = session.scalars(sa.select(Meal)).one()
    assert (event.actor_kind, event.subject, event.study_id) == ("device", str(meal.alias), meal.study_id)
    assert event.details == {"slot": "left", "width_px": 1600}


def test_width_is_kept_to_and_never_enlarged_and_what_is_no_photograph_is_not_found(phone):
    path = sent(phone)
    assert opened(phone.get(f"{path}/left", width=100)).size == (100, 75)
    assert opened(phone.get(f"{path}/left", width=4096)).size == (640, 480)
    for width in (63, 4097, "wide"):
        assert phone.get(f"{path}/left", width=width).status_code == 422
    assert phone.get(f"{path}/after_left").status_code == 404
    assert phone.get(f"{path}/above").status_code == 422
    assert phone.get(f"/v1/meals/{uuid.uuid4()}/images/left").status_code == 404


def test_only_its_own_phone_and_staff_see_a_photograph(phone, enrol, client, admin, state):
    path = sent(phone)
    for other in (enrol("P002"), enrol("P001", study="another")):
        assert other.get(f"{path}/left").status_code == 404
    assert readings(state) == []
    assert client.get(f"{path}/left", headers=admin).status_code == 200
    assert [event.actor_kind for event in readings(state)] == ["staff"]


def test_erased_photograph_is_gone_even_for_who_has_its_tag(phone, state):
    path = sent(phone)
    tag = phone.get(f"{path}/left").headers["etag"]
    with state.database.write() as session:
        session.execute(sa.update(MealImage).where(MealImage.slot == "left").values(erased_at=datetime.now(UTC)))
    for headers in ({}, {"If-None-Match": tag}):
        answer = phone.client.get(f"{path}/left", headers=phone.headers | headers)
        assert refusal(answer) == (410, "photograph_erased")
    assert phone.get(f"{path}/right").status_code == 200
    assert len(readings(state)) == 2


def test_photograph_that_changed_on_the_disk_is_not_shown(phone, state):
    path = sent(phone)
    with state.database.read() as session:
        key = session.scalars(sa.select(MealImage.blob_key).where(MealImage.slot == "left")).one()
    damage(state.blobs, key, b"another photograph")
    assert refusal(phone.get(f"{path}/left")) == (500, "photo_damaged")
    assert readings(state) == []


def grey_photograph(level=100):
    buffer = io.BytesIO()
    Image.fromarray(np.full((480, 640, 3), level, np.uint8)).save(buffer, "JPEG", quality=95)
    return buffer.getvalue()


def estimated(state, meal_id, purpose="meal", **gains):
    """A run of the pair whose corrections are gains of red, green and blue: left=(...), right=(...)."""
    sides = {side: colour_to_json(ColourCorrection(np.diag(three), "white")) for side, three in gains.items()}
    estimates.save(state, meal_id, apple(hint=None), purpose=purpose, colour=sides or None)


def middle(answer):
    return np.array(opened(answer).getpixel((200, 200)))


def test_photograph_is_corrected_by_the_newest_run_of_its_pair_or_given_as_taken(phone, state):
    path = sent(phone, {"left": grey_photograph(), "right": grey_photograph(101)})
    meal_id = path.split("/")[3]
    before = phone.get(f"{path}/left")
    assert (before.headers["x-colour-correction"], middle(before).tolist()) == ("none", [100, 100, 100])
    seen = phone.headers | {"If-None-Match": before.headers["etag"]}
    assert phone.client.get(f"{path}/left", headers=seen).status_code == 304
    estimated(state, meal_id, left=(2.0, 1.0, 0.5), right=(1.0, 1.0, 2.0))
    assert phone.client.get(f"{path}/left", headers=seen).status_code == 200
    assert phone.client.get(f"{path}/left", params={"colour": "as_taken"}, headers=seen).status_code == 304
    left, right = phone.get(f"{path}/left"), phone.get(f"{path}/right")
    assert left.headers["x-colour-correction"] == "white"
    assert middle(left) == pytest.approx([137, 100, 71], abs=3)  # sRGB of twice and of half the light of 100
    assert middle(right) == pytest.approx([101, 101, 138], abs=3)
    taken = phone.get(f"{path}/left", colour="as_taken")
    assert (taken.headers["x-colour-correction"], taken.content) == ("none", before.content)
    tags = {answer.headers["etag"] for answer in (before, left, right)}
    assert len(tags) == 3
    assert taken.headers["etag"] == before.headers["etag"]
    assert phone.get(f"{path}/left", colour="sepia").status_code == 422


def test_after_meal_photograph_is_corrected_by_the_after_meal_run_of_its_own_pair(phone, state):
    table = Table(phone, state)
    estimated(state, table.id, left=(1.0, 1.0, 1.0), right=(1.0, 1.0, 1.0))
    table.put("after_left", grey_photograph())
    table.put("after_right", grey_photograph(101))
    path = f"/v1/meals/{table.id}/images"
    assert middle(phone.get(f"{path}/after_left")).tolist() == [100, 100, 100]
    sides = {side: colour_to_json(ColourCorrection(np.diag((2.0, 1.0, 0.5)), "white")) for side in ("left", "right")}
    failure = {"code": "baseline_too_small", "message": "Too near.", "advice": "Move."}
    estimates.save(state, table.id, purpose="after", colour=sides, failure=failure)
    assert middle(phone.get(f"{path}/after_left")) == pytest.approx([137, 100, 71], abs=3)
    assert middle(phone.get(f"{path}/left")).tolist() != [100, 100, 100]  # noise, as it was sent
    table.put("after_left", grey_photograph(102))  # in place of the failed pair, without its correction
    assert middle(phone.get(f"{path}/after_left")).tolist() == [102, 102, 102]
    table.put("after_right", grey_photograph(103))
    assert middle(phone.get(f"{path}/after_left")).tolist() == [102, 102, 102]
    estimated(state, table.id, "after", left=(2.0, 1.0, 0.5), right=(1.0, 1.0, 1.0))
    assert phone.get(f"{path}/after_left").headers["x-colour-correction"] == "white"


def test_webp_pair_is_taken_and_shown(phone):
    body = meal_metadata()
    sent = phone.post(pair(kind="WEBP"), body)
    assert sent.status_code == 202, sent.text
    assert sent.json()["images"]["left"]["media_type"] == "image/webp"
    shown = phone.get(f"/v1/meals/{body['id']}/images/left", width=64)
    assert (shown.status_code, shown.headers["content-type"]) == (200, "image/jpeg")
    webp = {"Content-Type": "image/webp"}
    whole = phone.put(f"/v1/meals/{uuid.uuid4()}/images/left", headers=webp, content=b"RIFF")
    assert refusal(whole) == (415, "not_an_image")
