"""A real Chromium that watches itself: what it logs, what its scripts throw, and whatever it asks of another host.

`tabs` gives pages in fresh profiles; when the test ends, each must have been quiet.
"""

import contextlib
import os
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from axe_playwright_python.sync_playwright import DEFAULT_OPTIONS, Axe
from playwright.sync_api import expect

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
ARGUMENTS = (
    "--no-sandbox",  # a container's root has none
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",  # what leaves is seen, and fails
)
SOFTWARE_3D = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")  # WebGL where there is no graphics card
COOKIES: dict[tuple[str, str], Any] = {}  # of who has signed in, by server and name
WAIT_MS = 60_000  # of a machine that is busy with other work
# what sticks out of the window: not what stands in a region that scrolls
WIDER = """() => {
  const width = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth <= width) return [];
  const cuts = (one) => getComputedStyle(one).overflowX !== "visible";
  const scrolls = (one) => one !== null && (cuts(one) || scrolls(one.parentElement));
  const out = [...document.body.querySelectorAll("*")].filter((one) =>
    one.getBoundingClientRect().right > width + 1 && !scrolls(one.parentElement));
  return out.length ? out.slice(0, 3).map((one) => one.outerHTML.slice(0, 150)) : ["the document"];
}"""
expect.set_options(timeout=WAIT_MS)


@dataclass
class WatchedPage:
    """A tab of a fresh profile. page: Playwright's own. address: of the server that alone may be asked."""

    page: Any
    address: str
    console: list[str] = field(default_factory=list)  # errors and warnings
    thrown: list[str] = field(default_factory=list)
    outside: list[str] = field(default_factory=list)
    _expected: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Begin to watch."""
        self.page.on("console", self._note_console)
        self.page.on("pageerror", lambda error: self.thrown.append(str(error)))
        self.page.on("request", self._note_request)

    def goto(self, path: str) -> Any:
        """A page of the server."""
        return self.page.goto(self.address + path)

    def sign_in(self, name: str, password: str, path: str = "/dashboard") -> None:
        """By the form, the first time, and later by the cookie that it gave; then go to the page of this path."""
        if cookies := COOKIES.get((self.address, name)):
            self.page.context.add_cookies(cookies)
        else:
            self.goto("/dashboard/sign-in")
            self.page.fill("#name", name)
            self.page.fill("#password", password)
            self.page.click("button.main")
            self.page.wait_for_url(re.compile(r".*/dashboard$"))
            COOKIES[self.address, name] = self.page.context.cookies()
        self.goto(path)

    def expect(self, pattern: str) -> None:
        """Chromium logs every answer from 400 on as an error: such a line is expected by this test."""
        self._expected.append(pattern)

    def require_quiet(self) -> None:
        """Nothing was logged, thrown or asked of others but what was expected."""
        logged = [line for line in self.console if not any(re.search(one, line) for one in self._expected)]
        heard = {"console": logged, "thrown": self.thrown, "outside": self.outside}
        assert not any(heard.values()), heard

    def _note_console(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.console.append(f"{message.type}: {message.text} ({message.location['url']})")

    def _note_request(self, request: Any) -> None:
        parts = urlsplit(request.url)
        if parts.scheme not in ("data", "blob") and f"{parts.scheme}://{parts.netloc}" != self.address:
            self.outside.append(request.url)


@contextlib.contextmanager
def tabs(browser: Any) -> Iterator[Callable[..., WatchedPage]]:
    """Yield what opens a tab of its own profile; at the end each of them must have been quiet."""
    opened: list[tuple[Any, WatchedPage]] = []

    def open_page(address: str, **options: Any) -> WatchedPage:
        context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **options})
        context.set_default_timeout(WAIT_MS)
        watched = WatchedPage(context.new_page(), address)
        opened.append((context, watched))
        return watched

    try:
        yield open_page
    finally:
        for context, _ in opened:
            context.close()
    for _, watched in opened:
        watched.require_quiet()


def violations(page: Any, **options: Any) -> list[tuple[str, str, str]]:
    """What axe finds on a page, and what is wider than the window: (rule, impact, the first element)."""
    found = Axe().run(page, options=DEFAULT_OPTIONS | options).response["violations"]
    rules = [(one["id"], one["impact"], one["nodes"][0]["html"][:200]) for one in found]
    return rules + [("wider than the window", "serious", one) for one in page.evaluate(WIDER)]


def require_legible(page: Any, name: str) -> None:
    """Nothing is wrong on the page, wide and narrow. TADA_TEST_PICTURES: a folder for what it looks like."""
    for width, scheme in ((1280, "light"), (390, "dark")):
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size({"width": width, "height": 900})
        if folder := os.environ.get("TADA_TEST_PICTURES"):
            page.screenshot(path=f"{folder}/{name}-{width}.png", full_page=True)
        assert violations(page) == []
    page.set_viewport_size({"width": 1280, "height": 900})
