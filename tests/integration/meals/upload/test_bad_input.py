"""Bad input is normal input: each gets its code and a sentence, and nothing is kept of a refused request."""

import errno
import io
import json
import struct
import uuid
import zlib
from datetime import UTC, datetime, timedelta

import pillow_heif
from PIL import Image
from starlette.requests import Request

from app.meals.stored.models import Meal
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.support.photographs import pair, photograph
from tests.support.stores import stored_names


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_bomb(width, height):
    """A PNG whose header promises a huge picture, in some hundred bytes."""
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(b"\0" * 1000))
        + chunk(b"IEND", b"")
    )


def with_fewer_rows(png):
    """The PNG, sound in all its chunks, whose pixels end too early."""
    pixels = zlib.decompress(b"".join(content for kind, content in chunks_of(png) if kind == b"IDAT"))
    data = zlib.compress(pixels[: len(pixels) // 2])
    kept = [(kind, content) for kind, content in chunks_of(png) if kind != b"IDAT"]
    return png[:8] + b"".join(chunk(*each) for each in (*kept[:-1], (b"IDAT", data), kept[-1]))


def chunks_of(png):
    position = 8
    while position < len(png):
        end = position + 8 + int.from_bytes(png[position : position + 4])
        yield png[position + 4 : position + 8], png[position + 8 : end]
        position = end + 4


def assert_nothing_kept(state):
    assert stored_names(state.blobs) == []
    with state.database.read() as session:
        assert session.query(Meal).count() == 0


def refused(answer, status, code, state):
    body = answer.json()
    assert (answer.status_code, body["code"]) == (status, code), body
    assert answer.headers["content-type"] == "application/problem+json"
    assert body["status"] == status
    assert len(body["detail"]) > 20
    assert body["detail"][-1] in ".!"
    assert body["retryable"] is False
    assert_nothing_kept(state)
    return body


def test_photograph_that_cannot_be_taken_is_refused(phone, state):
    for left, status, code, facts in (
        (b"", 422, "part_empty", {}),
        (b"hello, I am a text", 415, "not_an_image", {}),
        (photograph()[:-2000], 422, "image_truncated", {}),
        (b"\xff\xd8\xff\xe0" + b"\0" * 50, 422, "image_unreadable", {}),
        (photograph(size=(640, 472)), 422, "image_too_small", {}),
        (with_fewer_rows(photograph(kind="PNG")), 422, "image_unreadable", {}),
        (png_bomb(60_000, 60_000), 413, "image_too_many_pixels", {"limit_pixels": 3_000_000}),
        (photograph(size=(2048, 1536), quality=20), 413, "image_too_many_pixels", {"limit_pixels": 3_000_000}),
        (b"\xff\xd8" + b"x" * 400_000, 413, "image_too_large", {"limit_bytes": 400_000}),
    ):
        body = refused(phone.post(pair() | {"left": left}), status, code, state)
        assert (facts | {"slot": "left"}).items() <= body.items()


def test_other_formats_and_the_same_photograph_twice_are_taken(phone):
    png = photograph(kind="PNG", mode="L")
    buffer = io.BytesIO()
    pillow_heif.from_pillow(Image.open(io.BytesIO(photograph()))).save(buffer, quality=50)
    for left, media_type in ((png, "image/png"), (buffer.getvalue(), "image/heic"), (photograph(1), "image/jpeg")):
        answer = phone.post({"left": left, "right": photograph(1)})
        assert answer.status_code == 202, answer.json()
        assert answer.json()["images"]["left"]["media_type"] == media_type


def test_size_told_is_the_upright_size(phone):
    exif = Image.Exif()
    exif[0x0112] = 5
    image = phone.post(pair() | {"left": photograph(exif=exif)}).json()["images"]["left"]
    assert (image["width_px"], image["height_px"]) == (480, 640)


def test_missing_part_is_named(phone, state):
    for slot in ("left", "right"):
        photos = pair()
        del photos[slot]
        assert refused(phone.post(photos), 400, "part_missing", state)["parts"] == [slot]
    answer = phone.client.post("/v1/meals", headers=phone.headers, files=pair())
    assert refused(answer, 400, "part_missing", state)["parts"] == ["metadata"]


BAD_METADATA = [
    (b"{not json", 400, "metadata_not_json"),
    (b"\xff\xfe\x00", 400, "metadata_not_json"),
    (b"[]", 422, "metadata_invalid"),
    (b"{}", 422, "metadata_invalid"),
    (b" " * 70_000, 413, "metadata_too_large"),
    (meal_metadata(id="not-a-uuid"), 422, "metadata_invalid"),
    (meal_metadata(**{f"f{n}": n for n in range(51)}), 422, "metadata_field_unknown"),
    (meal_metadata(captured_at="2026-11-20T12:30:00"), 422, "time_without_offset"),
    (meal_metadata(captured_at="2026-02-30T00:00:00Z"), 422, "metadata_invalid"),
    (meal_metadata(time_zone="Nowhere/Land"), 422, "time_zone_unknown"),
    (meal_metadata(marker="plain:9999x7:11"), 422, "marker_invalid"),
    (meal_metadata(marker="coin:eur-3"), 422, "marker_invalid"),
    (meal_metadata(location={"latitude": 91, "longitude": 0}), 422, "metadata_invalid"),
    (meal_metadata(location={"latitude": 0, "longitude": -180.5}), 422, "metadata_invalid"),
    (meal_metadata(location={"latitude": "1", "longitude": 0}), 422, "metadata_invalid"),
    (b'{"id": "0b0ccda4-7f0e-4e34-9a39-1f0c6d3bb9c1", "location": {"latitude": NaN, "longitude": 0}}', 0, ""),
    (meal_metadata(hints=[{"point": [1, 2], "box": [1, 2, 3, 4]}]), 422, "metadata_invalid"),
    (meal_metadata(hints=[{"box": [1, 2, 0, 4]}]), 422, "metadata_invalid"),
    (meal_metadata(hints=[{"polygon": [[1, 2], [3, 4]]}]), 422, "metadata_invalid"),
    (meal_metadata(hints=[{}]), 422, "metadata_invalid"),
    (meal_metadata(hints=[{"food": "apple"}] * 21), 422, "metadata_invalid"),
    (meal_metadata(camera={"width": 100}), 422, "metadata_invalid"),
    (meal_metadata(camera={"width": 1, "height": 1, "fx": 0, "fy": 1, "cx": 0, "cy": 0}), 422, "metadata_invalid"),
]


def test_bad_metadata_is_refused_with_its_code(phone, state):
    for metadata, status, code in BAD_METADATA:
        answer = phone.post(pair(), metadata)
        if status:
            refused(answer, status, code, state)
        else:  # NaN is no JSON, though some parsers take it: either code is right, as long as it is refused
            assert answer.json()["code"] in ("metadata_not_json", "metadata_invalid")
            assert_nothing_kept(state)


def test_meal_of_the_day_after_tomorrow_is_not_refused_for_good_since_the_servers_clock_may_be_behind(phone, state):
    ahead = (datetime.now(UTC) + timedelta(days=2)).isoformat()
    answer = phone.post(pair(), meal_metadata(captured_at=ahead, time_zone="UTC"))
    assert (answer.status_code, answer.json()["code"], answer.json()["retryable"]) == (409, "clock_differs", True)
    assert answer.headers["Retry-After"] == "600"
    assert abs(datetime.fromisoformat(answer.json()["server_time"]) - datetime.now(UTC)) < timedelta(minutes=1)
    assert_nothing_kept(state)


def test_full_or_nearly_full_disk_is_told_and_the_same_request_works_later(phone, state, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    def is_read(_):
        raise AssertionError("the body was read")

    photos, metadata = pair(), meal_metadata()
    jpeg = {"Content-Type": "image/jpeg"}
    for patches in (
        {(type(state.blobs), "put_files"): full},
        {(type(state.blobs), "free_bytes"): lambda _: -1, (Request, "stream"): is_read},
    ):
        with monkeypatch.context() as patch:
            for (owner, name), value in patches.items():
                patch.setattr(owner, name, value)
            answers = [phone.post(photos, metadata)]
            if len(patches) == 2:  # a photograph by itself neither
                image = f"/v1/meals/{uuid.uuid4()}/images/left"
                answers.append(phone.put(image, content=photos["left"], headers=jpeg))
        for answer in answers:
            assert (*refusal(answer), answer.json()["retryable"]) == (503, "storage_full", True)
            assert int(answer.headers["retry-after"]) >= 30
        assert_nothing_kept(state)
    assert phone.post(photos, metadata).status_code == 202


def test_large_body_on_another_route_is_refused(client, admin):
    for body in (b"x" * 300_000, iter([b"x" * 100_000] * 3)):
        answer = client.post("/v1/studies", headers=admin, content=body)
        assert answer.status_code == 413, answer.text


def test_announcement_that_is_too_large_and_a_slot_that_does_not_exist_are_refused(phone):
    metadata = meal_metadata(app_version="x" * 70_000)
    path = f"/v1/meals/{metadata.pop('id')}"
    answer = phone.put(path, content=json.dumps(metadata))
    assert (answer.status_code, answer.json()["limit_bytes"]) == (413, 65536)
    assert refusal(phone.put(f"{path}/images/middle", content=b"x")) == (422, "invalid_input")


def test_number_is_no_day_and_no_instant(client, admin, phone):
    """`?to=0` was 1 January 1970."""
    number = "0"
    for path in ("/v1/records", "/v1/days", "/v1/meals", "/v1/audit", "/v1/studies/pilot/overview"):
        answer = client.get(path, headers=admin, params={"to": number})
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input"), (path, answer.text)
    assert phone.put(f"/v1/me/days/{number}", json={"status": "closed"}, headers={"If-Match": "*"}).status_code == 422
    person = {"code": "P9", "starts_on": number}
    assert client.post("/v1/studies/pilot/participants", headers=admin, json=person).status_code == 422
    told = phone.post(pair(), meal_metadata(captured_at=number))
    assert (told.status_code, told.json()["code"]) == (422, "metadata_invalid")
