"""A real Chromium that watches itself: what it logs, what its scripts throw, and whatever it asks of another host.

`open_page` gives pages in fresh profiles; when the test ends, each must have been quiet. Tests that use it are skipped,
saying so, where there is no chromium.
"""

import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import pytest
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
WAIT_MS = 60_000  # of a machine that is busy with other work
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
        """By the form, then to the page of this path."""
        self.goto("/dashboard/sign-in")
        self.page.fill("#name", name)
        self.page.fill("#password", password)
        self.page.click("button.main")
        self.page.wait_for_url(re.compile(r".*/dashboard$"))
        if path != "/dashboard":
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


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """The browser, one a module: while it is open, its loop runs in this thread, where others could start none."""
    if CHROMIUM is None:
        pytest.skip("there is no chromium on this machine")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=[*ARGUMENTS, *SOFTWARE_3D])
        yield browser
        browser.close()


@pytest.fixture
def open_page(chromium: Any) -> Iterator[Callable[..., WatchedPage]]:
    """A tab of its own profile on a server: open_page(address, color_scheme="dark", viewport={...})."""
    opened: list[tuple[Any, WatchedPage]] = []

    def open_page(address: str, **options: Any) -> WatchedPage:
        context = chromium.new_context(**{"viewport": {"width": 1280, "height": 900}, **options})
        context.set_default_timeout(WAIT_MS)
        watched = WatchedPage(context.new_page(), address)
        opened.append((context, watched))
        return watched

    yield open_page
    for context, _ in opened:
        context.close()
    for _, watched in opened:
        watched.require_quiet()
