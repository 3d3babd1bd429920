"""From the printed card to a confirmed meal: its QR code is read by the phone's camera app, or by the page itself."""

import base64
import json

import cv2
import numpy as np
import pytest
import zxingcpp
from playwright.sync_api import expect

from app.people.devices import capture_link, enrolment_text, qr_png
from tests.e2e.browser import ARGUMENTS, CHROMIUM, WatchedPage
from tests.e2e.capture.capture_page import first_photograph, send
from tests.e2e.capture.conftest import PHONE
from tests.e2e.dashboard_server import PASSWORD, require
from tests.e2e.fake_camera import camera_arguments, write_video
from tests.e2e.processes import REPOSITORY
from tests.support import estimates
from tests.support.estimates import identified_item
from tests.support.waiting import wait_until

PAIR = REPOSITORY / "app" / "demo_data" / "orange_kiwifruit"  # taken as the page asks: 9.7 degrees apart
SIZE = (1280, 960)  # of the pair
DOTS_PER_PX = 3  # of the screenshot: a printer's 288 dots per inch
CAMERA_APPS, PAGES = "P041", "P042"
CODES = ["XFn1kTPJyd4oYn9o8QaEgQ", "a4ayc_80_OGda4BO_1o_V2"]
SCAN = """async (png) => {
  const { scan } = await import("/capture/qr_scan.js");
  const { codeIn } = await import("/capture/pages/enrol.js");
  const picture = await createImageBitmap(new Blob([Uint8Array.from(atob(png), (letter) => letter.charCodeAt(0))]));
  const canvas = Object.assign(document.createElement("canvas"), { width: picture.width, height: picture.height });
  const context = canvas.getContext("2d");
  const video = Object.assign(document.createElement("video"), { srcObject: canvas.captureStream(), muted: true });
  const drawing = setInterval(() => context.drawImage(picture, 0, 0), 100); // a frame each time
  await video.play();
  let frames = 0;
  const code = await scan(video, codeIn, () => frames++ < 28); // each part at each size, twice
  clearInterval(drawing);
  return code;
}"""
SLOW_CAMERA = """() => {
  const ask = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);
  navigator.mediaDevices.getUserMedia = (options) => new Promise((resolve) => {
    window.allow = async () => {
      const stream = await ask(options);
      [window.track] = stream.getTracks();
      resolve(stream);
    };
  });
}"""


def photographed(card):
    """A card (h, w, 3) on a grey table, seen from the side by a hand-held camera; both codes are in the picture."""
    height, width = card.shape[:2]
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    seen = np.array([[490, 50], [800, 70], [850, 890], [450, 850]], np.float32)
    matrix = cv2.getPerspectiveTransform(corners, seen)
    card = cv2.GaussianBlur(card, (0, 0), 1.0)
    picture = cv2.warpPerspective(card, matrix, SIZE, flags=cv2.INTER_AREA, borderValue=(120, 130, 140))
    noise = np.random.default_rng(1).normal(0, 4, picture.shape)
    return np.clip(cv2.GaussianBlur(picture, (0, 0), 1.0) + noise, 0, 255).astype(np.uint8)


def crowded_card(code):
    """A card (h, w, 3) whose two codes are so near to each other that the decoder mixes up their finder patterns."""
    card = np.full((1040, 420, 3), 255, np.uint8)
    server = "http://127.0.0.1:8000"
    for top, text in ((130, capture_link(server, code)), (500, enrolment_text(server, code))):
        drawn = cv2.imdecode(np.frombuffer(qr_png(text), np.uint8), cv2.IMREAD_COLOR)
        card[top : top + 260, 80:340] = cv2.resize(drawn, (260, 260), interpolation=cv2.INTER_AREA)
    return card


@pytest.fixture(scope="module")
def cards(chromium, served):
    """The cards as the dashboard prints them, photographed, by participant."""
    served.make_staff("olga", capture="owner")
    for participant in (CAMERA_APPS, PAGES):
        require(served.admin.post("/v1/studies/capture/participants", json={"code": participant}))
    desk = WatchedPage(chromium.new_page(device_scale_factor=DOTS_PER_PX), served.address)
    desk.sign_in("olga", PASSWORD, "/dashboard/studies/capture/enrol")
    desk.page.get_by_label("Participants").fill(f"{CAMERA_APPS} {PAGES}")
    desk.page.get_by_label("The study has an app").check()
    desk.page.get_by_role("button", name="Create the cards").click()
    desk.page.emulate_media(media="print")
    cards = {}
    for participant in (CAMERA_APPS, PAGES):
        card = desk.page.get_by_label(f"Card of {participant}").screenshot()
        cards[participant] = photographed(cv2.imdecode(np.frombuffer(card, np.uint8), cv2.IMREAD_COLOR))
    desk.page.close()
    desk.require_quiet()
    return cards


@pytest.fixture(scope="module")
def browser(driver, cards, tmp_path_factory):
    """A phone's browser whose camera sees a packet of soup, the card, the meal from the left and from the right."""
    video = tmp_path_factory.mktemp("camera") / "walk.y4m"
    pair = [cv2.imread(str(PAIR / f"{side}.jpg")) for side in ("left", "right")]
    packet = np.full_like(pair[0], 90)
    code = cv2.imdecode(np.frombuffer(qr_png("https://soup.example/recipes#a"), np.uint8), cv2.IMREAD_COLOR)
    packet[300 : 300 + len(code), 500 : 500 + len(code)] = code
    write_video(video, [packet, cards[PAGES], *pair], frames_of_each=6)
    browser = driver.chromium.launch(executable_path=CHROMIUM, args=[*ARGUMENTS, *camera_arguments(video)])
    yield browser
    browser.close()


def test_camera_app_reads_the_link_on_the_printed_card_and_the_page_joins(served, cards, open_page):
    for_app, link = sorted((code.text for code in zxingcpp.read_barcodes(cards[CAMERA_APPS])), reverse=True)
    address, _, code = link.partition("#code=")
    assert address == f"{served.address}/capture/"
    assert json.loads(for_app) == {"tada": 1, "server": served.address, "code": code}
    tab = open_page(served.address, **PHONE)
    tab.page.goto(link)
    tab.page.get_by_text(f"Participant {CAMERA_APPS}").wait_for()
    tab.page.get_by_role("button", name="Photograph a meal").wait_for()
    assert "code=" not in tab.page.url
    tab.page.go_back()
    assert "code=" not in tab.page.url


@pytest.mark.slow
def test_from_the_card_before_the_page_s_camera_to_a_confirmed_meal_without_a_keyboard(served, open_phone):
    tab = open_phone()
    page = tab.page
    tab.goto("/capture/")
    page.get_by_role("button", name="Scan the card").click()
    page.get_by_text(f"Participant {PAGES}").wait_for()
    page.get_by_role("button", name="Photograph a meal").click()
    page.wait_for_selector(".advice[data-advice=good]")
    first_photograph(page)
    page.wait_for_selector(".advice[data-advice=move_right]")
    expect(page.locator(".outline .first")).to_have_count(1)
    page.wait_for_selector(".advice[data-advice=good]")
    page.get_by_role("button", name="Take the photograph").click()
    page.get_by_role("heading", name="Are both good?").wait_for()
    meal = send(page)
    images = served.meal(meal)["images"]
    sizes = {slot: (image["width_px"], image["height_px"]) for slot, image in images.items()}
    assert sizes == {"left": SIZE, "right": SIZE}
    page.click(f"li[data-meal='{meal}'] a")
    page.get_by_text("Waiting to be measured").wait_for()
    estimates.save(served, meal, identified_item({"orange": 0.9}))  # the page waits for it
    page.get_by_role("button", name="That is right").click()
    page.wait_for_selector("li[data-status=confirmed]")
    expect(page.locator("svg .food")).to_have_count(1)
    confirmed = served.meal(meal)
    assert (confirmed["status"], confirmed["participant"]) == ("confirmed", PAGES)


@pytest.mark.slow
@pytest.mark.parametrize("code", CODES)
def test_card_whose_codes_are_near_each_other_is_read_by_a_camera_that_is_held_still(open_phone, code):
    tab = open_phone()
    tab.goto("/capture/")
    picture = cv2.imencode(".png", photographed(crowded_card(code)))[1]
    assert tab.page.evaluate(SCAN, base64.b64encode(picture).decode()) == code


@pytest.mark.slow
def test_camera_that_is_allowed_after_the_page_was_left_is_released(open_phone):
    tab = open_phone()
    tab.goto("/capture/")
    tab.page.evaluate(SLOW_CAMERA)
    tab.page.get_by_role("button", name="Scan the card").click()
    tab.page.evaluate('location.hash = "another"')
    tab.page.get_by_role("button", name="Scan the card").wait_for()
    tab.page.evaluate("window.allow()")
    wait_until(lambda: tab.page.evaluate("track.readyState") == "ended", "the camera to be released")
