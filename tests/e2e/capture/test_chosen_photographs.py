"""Photographs that a participant chooses as files: what is refused at once, and when they were taken."""

import pytest
from playwright.sync_api import expect

from tests.e2e.capture.capture_page import enrolled

pytestmark = pytest.mark.slow


def choose(page, file):
    """Choose a file, a path or its name, type and bytes, for the photograph that the page asks for."""
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Choose a photograph").click()
    chooser.value.set_files(file)


def test_file_that_is_no_photograph_is_refused_before_anything_is_kept(served, open_phone):
    page = enrolled(served, open_phone())
    page.get_by_role("button", name="Photograph a meal").click()
    choose(page, {"name": "meal.jpg", "mimeType": "image/jpeg", "buffer": b"%PDF-1.7 a menu"})
    page.get_by_text("This file is not a photograph.").wait_for()
    expect(page.get_by_role("heading", name="First photograph")).to_be_visible()
    kept = page.evaluate('import("/capture/store.js").then((store) => store.meals()).then((meals) => meals.length)')
    assert kept == 0
