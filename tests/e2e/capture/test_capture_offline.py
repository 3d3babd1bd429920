"""Meals that were photographed offline in the capture page reach the server once each, whatever ends meanwhile.

The browser's profile outlives the browser, as a phone's does: its store is the same after SIGKILL.
"""

import base64
import contextlib
import hashlib
import os
import signal
from pathlib import Path

import playwright.sync_api
import pytest

from tests.e2e.browser import ARGUMENTS, CHROMIUM, WAIT_MS
from tests.e2e.dashboard_server import require
from tests.support.photographs import pair
from tests.support.waiting import wait_until

pytestmark = pytest.mark.slow

MEALS = int(os.environ.get("TADA_TEST_MEALS", "16"))
RELOADS = 4
SENDING_SECONDS = 300

SAVE = """async ([meals]) => {
  const store = await import("/capture/store.js");
  const { newDraft } = await import("/capture/pages/take.js");
  const photograph = (text) => new Blob([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))], { type: "image/jpeg" });
  const phone = await store.phone();
  const ids = [];
  for (const { captured_at, left, right } of meals) {
    const meal = { ...newDraft(phone), captured_at, time_zone: "Europe/Berlin", slots: ["left"] };
    await store.saveDraft(meal, { left: photograph(left) });
    await store.saveDraft({ ...meal, slots: ["left", "right"], state: "waiting" }, { right: photograph(right) });
    ids.push(meal.id);
  }
  return ids;
}"""
UNSENT = """async () => {
  const store = await import("/capture/store.js");
  return (await store.meals()).filter((meal) => meal.state !== "sent").length;
}"""
PHOTOGRAPHS_LEFT = """async () => {
  const store = await import("/capture/store.js");
  const places = (await store.meals()).flatMap(({ id, slots }) => slots.map((slot) => [id, slot]));
  return (await Promise.all(places.map((place) => store.photograph(...place)))).filter(Boolean).length;
}"""


class Phone:
    """A browser on a profile that outlives it."""

    def __init__(self, driver, folder, address):
        self._driver, self._folder, self._address = driver, folder, address
        self.context = None

    def start(self):
        self.context = self._driver.chromium.launch_persistent_context(
            self._folder, executable_path=CHROMIUM, args=[*ARGUMENTS], viewport={"width": 390, "height": 844}
        )
        self.context.set_default_timeout(WAIT_MS)
        return self.context.pages[0]

    def open(self, page, path="/capture/"):
        page.goto(self._address + path)
        page.wait_for_selector("main h1")

    def kill(self):
        """SIGKILL to every process of the browser on this profile, as when the battery dies."""
        for process in Path("/proc").glob("[0-9]*"):
            try:
                command = (process / "cmdline").read_bytes()
            except OSError:
                continue
            if f"--user-data-dir={self._folder}".encode() in command:
                os.kill(int(process.name), signal.SIGKILL)
        with contextlib.suppress(playwright.sync_api.Error):  # it may already know that the browser is gone
            self.context.close()


@pytest.fixture
def phone(served, driver, tmp_path):
    served.make_study("offline")
    require(served.admin.post("/v1/studies/offline/participants", json={"code": "P001"}))
    phone = Phone(driver, tmp_path / "profile", served.address)
    yield phone
    phone.context.close()


def meal_of(number):
    """Return a meal for SAVE, with other bytes for each number, and its photographs."""
    photographs = pair(seed=number)
    body = {slot: base64.b64encode(content).decode() for slot, content in photographs.items()}
    day, minute = divmod(number, 60)
    return body | {"captured_at": f"2026-11-{10 + day:02d}T12:{minute:02d}:00+01:00"}, photographs


def test_meals_taken_offline_arrive_once_each_though_browser_and_server_are_killed(served, phone):
    page = phone.start()
    code = require(served.admin.post("/v1/studies/offline/participants/P001/enrolment-codes"))
    page.goto(code["capture_url"])
    page.get_by_role("button", name="Photograph a meal").wait_for()
    page.evaluate("navigator.serviceWorker.ready.then(() => true)")

    expected = {}
    phone.context.set_offline(True)
    served.server.kill()
    a_reload = MEALS // RELOADS
    for first in range(0, MEALS, a_reload):
        meals, photographs = zip(*(meal_of(number) for number in range(first, first + a_reload)), strict=True)
        ids = page.evaluate(SAVE, [meals])
        expected |= dict(zip(ids, photographs, strict=True))
        page.reload()  # offline: the service worker has the page
        page.wait_for_selector(f"li[data-meal='{ids[-1]}']")
    assert page.evaluate(UNSENT) == len(expected) >= MEALS

    phone.kill()
    page = phone.start()
    served.server.start()
    served.server.wait_until_ready()
    phone.open(page)
    other = phone.context.new_page()
    phone.open(other)
    wait_for_at_most(page, MEALS * 3 // 4)
    served.server.kill()
    page.reload()
    served.server.start()
    served.server.wait_until_ready()
    try_now(page)
    wait_for_at_most(page, MEALS // 2)
    phone.kill()
    page = phone.start()
    phone.open(page)
    try_now(page)
    wait_for_at_most(page, 0)
    assert page.evaluate(PHOTOGRAPHS_LEFT) == 0

    listed = served.admin.get("/v1/meals", params={"study": "offline", "limit": 500}).json()["items"]
    assert sorted(meal["id"] for meal in listed) == sorted(expected)
    for meal in listed:
        images = served.meal(meal["id"])["images"]
        digests = {slot: hashlib.sha256(content).hexdigest() for slot, content in expected[meal["id"]].items()}
        assert {slot: image["received_sha256"] for slot, image in images.items()} == digests
        assert all(image["durable"] for image in images.values())


def try_now(page):
    """The waits after failed tries are minutes; the person does not wait for them."""
    page.evaluate(
        """async () => {
      const { retryNow, sendWaiting, isUnsent } = await import("/capture/sender.js");
      const store = await import("/capture/store.js");
      for (const meal of (await store.meals()).filter(isUnsent)) await retryNow(meal.id);
      sendWaiting();
    }"""
    )


def wait_for_at_most(page, count):
    """Until no more than so many meals wait."""
    words = f"no more than {count} meals to wait"
    wait_until(lambda: page.evaluate(UNSENT) <= count, words, patience_seconds=SENDING_SECONDS)
