"""Photographs that a participant chooses as files: what is refused at once, and when they were taken."""

import io

import pillow_heif
import pytest
from PIL import Image
from playwright.sync_api import expect

from app.capture.files import STATIC
from tests.e2e.capture.capture_page import enrolled, require_accessible
from tests.e2e.static_modules import open_modules
from tests.support.photographs import photograph

EXIF_IFD = 0x8769
TAKEN_AT = """async (bytes) => {
  const { takenAt } = await import("/chosen_file.js");
  return takenAt(new Uint8Array(bytes))?.toISOString() ?? null;
}"""
CAPTURED_AT = """async () => {
  const [draft] = await (await import("/capture/store.js")).meals();
  return new Date(draft.captured_at).toISOString();
}"""


def with_time(kind, time, offset):
    """A photograph whose EXIF says when it was taken, as far as it is told."""
    exif = Image.Exif()
    exif[EXIF_IFD] = {tag: text for tag, text in ((0x9003, time), (0x9011, offset)) if text}
    if kind == "JPEG":
        return photograph(exif=exif)
    buffer = io.BytesIO()
    pillow_heif.from_pillow(Image.open(io.BytesIO(photograph()))).save(buffer, exif=exif.tobytes())
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("kind", "time", "offset", "taken"),
    [
        ("JPEG", "2026:11:20 12:30:05", "+08:00", "2026-11-20T04:30:05.000Z"),
        ("HEIC", "2026:11:20 12:30:05", "+08:00", "2026-11-20T04:30:05.000Z"),
        ("JPEG", "2026:11:20 12:30:05", None, "2026-11-20T11:30:05.000Z"),  # of the phone's time zone
        ("JPEG", "0000:00:00 00:00:00", None, None),
        ("JPEG", None, None, None),
    ],
)
def test_time_of_a_photograph_is_its_exif_s(open_page, kind, time, offset, taken):
    tab = open_modules(lambda address: open_page(address, timezone_id="Europe/Berlin"), STATIC)
    assert tab.page.evaluate(TAKEN_AT, list(with_time(kind, time, offset))) == taken


def choose(page, file):
    """Choose a file, a path or its name, type and bytes, for the photograph that the page asks for."""
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Choose a photograph").click()
    chooser.value.set_files(file)


@pytest.mark.slow
def test_file_that_is_no_photograph_is_refused_before_anything_is_kept(served, open_phone):
    page = enrolled(served, open_phone())
    page.get_by_role("button", name="Photograph a meal").click()
    choose(page, {"name": "meal.jpg", "mimeType": "image/jpeg", "buffer": b"%PDF-1.7 a menu"})
    page.get_by_text("This file is not a photograph.").wait_for()
    expect(page.get_by_role("heading", name="First photograph")).to_be_visible()
    kept = page.evaluate('import("/capture/store.js").then((store) => store.meals()).then((meals) => meals.length)')
    assert kept == 0


@pytest.mark.slow
def test_time_of_a_chosen_photograph_is_asked_for_where_the_file_does_not_say_it(served, open_phone):
    page = enrolled(served, open_phone(timezone_id="Europe/Berlin"))
    page.get_by_role("button", name="Photograph a meal").click()
    choose(page, {"name": "meal.jpg", "mimeType": "image/jpeg", "buffer": photograph()})
    page.get_by_role("heading", name="When was this photograph taken?").wait_for()
    require_accessible(page)
    page.get_by_label("Day and time").fill("2026-11-20T12:30")
    page.get_by_role("button", name="Continue").click()
    page.get_by_role("heading", name="Second photograph").wait_for()
    assert page.evaluate(CAPTURED_AT) == "2026-11-20T11:30:00.000Z"
    choose(page, {"name": "meal.jpg", "mimeType": "image/jpeg", "buffer": photograph(1)})
    page.get_by_role("heading", name="Are both good?").wait_for()
