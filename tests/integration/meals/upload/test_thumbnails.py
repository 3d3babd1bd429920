"""Small pictures that a run leaves: what they show, that they are served as they are, that they go as all others."""

import hashlib
import io
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
import sqlalchemy as sa
from PIL import Image

from app.meals.estimate.estimate_json import colour_to_json
from app.meals.estimate.photo_tasks import picture_task
from app.meals.estimate.run_estimate import estimate_task
from app.meals.stored.record_models import RunArtefact
from app.meals.stored.run_answer import THUMBNAIL_PX
from app.people.models import Study
from app.people.privacy_models import AuditEvent
from app.privacy.delete_blobs import BlobDeleter
from app.privacy.retention import erase_old_pictures
from app.vision.model import ColourCorrection
from tests.integration.conftest import meal_metadata
from tests.support import estimates
from tests.support.estimates import found_item
from tests.support.photographs import pair, photograph
from tests.support.stores import damage

GREEN = (30, 200, 40)
OPTIONS = {"marker": "plain:9x7:11"}


def small_picture(colour=GREEN):
    buffer = io.BytesIO()
    Image.new("RGB", (THUMBNAIL_PX, 240), colour).save(buffer, "JPEG")
    return buffer.getvalue()


@pytest.fixture
def kept(phone, state):
    """A meal whose run has left a green thumbnail of each photograph, which are noise: the path of its pictures."""
    metadata = meal_metadata()
    assert phone.post(pair(5), metadata).status_code == 202
    listed = []
    for side in ("left", "right"):
        content = small_picture()
        key = f"x/{metadata['id']}/thumbnail_{side}.jpg"
        state.blobs.put_bytes(key, content)
        digest = hashlib.sha256(content).hexdigest()
        name = f"thumbnail_{side}.jpg"
        listed.append({"name": name, "media_type": "image/jpeg", "bytes": len(content), "sha256": digest})
        listed[-1]["blob_key"] = key
    estimates.save(state, metadata["id"], found_item(hint=None), artefacts=listed)
    return f"/v1/meals/{metadata['id']}/images"


def is_kept(answer):
    assert answer.status_code == 200, answer.text
    return answer.content == small_picture()


def test_run_leaves_both_photographs_small_upright_and_without_metadata_as_pictures_are_made_at_their_width(tmp_path):
    exif = Image.Exif()
    exif[0x0112], exif[0x010F] = 6, "a maker"  # lies on its side
    paths = {side: tmp_path / side for side in ("left", "right")}
    for seed, path in enumerate(paths.values()):
        path.write_bytes(photograph(seed, exif=exif))
    photographs = {name: str(path) for name, path in paths.items()}
    request = {"photographs": photographs, "options": OPTIONS, "output_dir": str(tmp_path), "max_pixels": 10**7}
    answer = estimate_task(request, lambda _: None)
    assert answer["failure"] is not None
    for side in paths:
        (listed,) = [one for one in answer["artefacts"] if one["name"] == f"thumbnail_{side}.jpg"]
        content = (tmp_path / listed["name"]).read_bytes()
        assert (listed["media_type"], listed["bytes"]) == ("image/jpeg", len(content))
        assert listed["sha256"] == hashlib.sha256(content).hexdigest()
        picture = Image.open(io.BytesIO(content))
        assert picture.size == (THUMBNAIL_PX, round(640 * THUMBNAIL_PX / 480))
        assert not picture.getexif()
        assert b"a maker" not in content
    thumbnail, made = np.asarray(Image.open(tmp_path / "thumbnail_left.jpg"), float), tmp_path / "made.jpg"
    request = {"photo": photographs["left"], "output": str(made), "width_px": THUMBNAIL_PX, "max_pixels": 10**7}
    picture_task(request | {"colour": None}, lambda _: None)
    difference = np.abs(np.asarray(Image.open(made), float) - thumbnail).mean()
    assert difference < 4.0  # of 255; halved while decoded, or afterwards
    gains = colour_to_json(ColourCorrection(np.diag([2.0, 1.0, 1.0]), "white"))
    picture_task(request | {"colour": gains}, lambda _: None)
    assert np.abs(np.asarray(Image.open(made), float) - thumbnail).mean() > 10.0


def test_thumbnail_is_served_at_its_width_alone_and_noted(phone, state, kept):
    first = phone.get(f"{kept}/left", width=THUMBNAIL_PX)
    assert is_kept(first)
    assert is_kept(phone.get(f"{kept}/right", width=THUMBNAIL_PX))
    assert not is_kept(phone.get(f"{kept}/left", width=THUMBNAIL_PX + 1))
    assert not is_kept(phone.get(f"{kept}/left", width=THUMBNAIL_PX, colour="as_taken"))
    known = phone.headers | {"If-None-Match": first.headers["etag"]}
    assert phone.client.get(f"{kept}/left?width=320", headers=known).status_code == 304
    with state.database.read() as session:
        noted = session.scalars(sa.select(AuditEvent).where(AuditEvent.action == "photograph.read")).all()
    assert sorted(event.details["width_px"] for event in noted) == [320, 320, 320, 321]


@pytest.mark.parametrize("fault", ["damaged", "missing"])
def test_photograph_is_shown_all_the_same_where_its_thumbnail_cannot_be(phone, state, kept, fault):
    with state.database.read() as session:
        key = session.scalars(sa.select(RunArtefact.blob_key).where(RunArtefact.name == "thumbnail_left.jpg")).one()
    if fault == "missing":
        state.blobs.delete(key)
    else:
        damage(state.blobs, key, b"another")
    answer = phone.get(f"{kept}/left", width=THUMBNAIL_PX)
    assert Image.open(io.BytesIO(answer.content)).size == (320, 240)
    assert not is_kept(answer)


def test_thumbnails_go_with_the_photographs(phone, state, kept):
    with state.database.write() as session:
        session.execute(sa.update(Study).values(retention_days=1))
    assert erase_old_pictures(state.database, datetime.now(UTC) + timedelta(days=2)) == 1
    assert phone.get(f"{kept}/left", width=THUMBNAIL_PX).status_code == 410
    BlobDeleter(state.database, state.blobs).delete_scheduled()
    meal_id = kept.split("/")[3]
    assert [blob.key for blob in state.blobs.keys(f"x/{meal_id}/")] == []
