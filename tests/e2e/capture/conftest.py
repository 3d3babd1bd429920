"""A server with a study, and a phone's browser whose camera sees the bundled pair."""

import cv2
import pytest

from tests.e2e.browser import ARGUMENTS, CHROMIUM, WAIT_MS, WatchedPage
from tests.e2e.capture.fake_camera import camera_arguments, write_video
from tests.e2e.dashboard_server import dashboard_server, require
from tests.e2e.processes import REPOSITORY

DEMO = REPOSITORY / "app" / "demo_data"
PHONE = {"viewport": {"width": 390, "height": 844}, "permissions": ["camera", "microphone"]}


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    server = dashboard_server(tmp_path_factory.mktemp("capture"), TADA_PUSH_CONTACT="mailto:study@example.org")
    server.make_study(expects_after_pair=True, after_window_minutes=240)
    require(server.admin.post("/v1/studies/pilot/participants", json={"code": "P001"}))
    yield server
    server.close()


@pytest.fixture(scope="module")
def driver():
    if CHROMIUM is None:
        pytest.skip("there is no chromium on this machine")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        yield driver


@pytest.fixture(scope="module")
def browser(driver, tmp_path_factory):
    """A phone's browser whose camera sees the bundled pair."""
    video = tmp_path_factory.mktemp("camera") / "pair.y4m"
    write_video(video, [cv2.imread(str(DEMO / f"{side}.jpg")) for side in ("left", "right")])
    browser = driver.chromium.launch(executable_path=CHROMIUM, args=[*ARGUMENTS, *camera_arguments(video)])
    yield browser
    browser.close()


@pytest.fixture
def open_phone(served, browser):
    """open_phone(address, **options): a tab of a fresh profile that must be quiet at the end."""
    opened = []

    def open_phone(address=served.address, **options):
        context = browser.new_context(**(PHONE | options))
        context.set_default_timeout(WAIT_MS)
        tab = WatchedPage(context.new_page(), address)
        tab.expect(r"status of 404.*/upload\)$")  # an upload in pieces is asked for before it is begun
        opened.append((context, tab))
        return tab

    yield open_phone
    for context, _ in opened:
        context.close()
    for _, tab in opened:
        tab.require_quiet()
