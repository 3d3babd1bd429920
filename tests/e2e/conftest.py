"""One Chromium and one server per worker, for all tests that walk through pages."""

import cv2
import pytest

from tests.e2e.browser import ARGUMENTS, CHROMIUM, SOFTWARE_3D, tabs
from tests.e2e.dashboard_server import dashboard_server, require
from tests.e2e.fake_camera import camera_arguments, write_video
from tests.e2e.processes import REPOSITORY

DEMO = REPOSITORY / "app" / "demo_data"


@pytest.fixture(scope="package")
def driver():
    """Playwright. Its loop runs in this thread, where others could start none: so it ends with this package."""
    if CHROMIUM is None:
        pytest.skip("there is no chromium on this machine")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        yield driver


@pytest.fixture(scope="package")
def chromium(driver, tmp_path_factory):
    """The browser. It draws in 3D by software, and its camera sees the bundled pair."""
    video = tmp_path_factory.mktemp("camera") / "pair.y4m"
    write_video(video, [cv2.imread(str(DEMO / f"{side}.jpg")) for side in ("left", "right")])
    arguments = [*ARGUMENTS, *SOFTWARE_3D, *camera_arguments(video)]
    browser = driver.chromium.launch(executable_path=CHROMIUM, args=arguments)
    yield browser
    browser.close()


@pytest.fixture
def open_page(chromium):
    """A tab of its own profile on a server: open_page(address, color_scheme="dark", viewport={...})."""
    with tabs(chromium) as open_page:
        yield open_page


@pytest.fixture(scope="package")
def served(tmp_path_factory):
    """A server with the study "pilot" and its reviewer "ann", and the study "capture" with its participant P001."""
    server = dashboard_server(tmp_path_factory.mktemp("served"), TADA_PUSH_CONTACT="mailto:study@example.org")
    try:
        server.make_study()
        server.make_staff("ann", pilot="reviewer")
        server.make_study("capture", expects_after_pair=True, after_window_minutes=240)
        require(server.admin.post("/v1/studies/capture/participants", json={"code": "P001"}))
        yield server
    finally:
        server.close()


@pytest.fixture(scope="package")
def phone(served):
    """The phone of P001 in the study "pilot"."""
    with served.enrol() as phone:
        yield phone
