"""An empty page beside static files, the dashboard's or others, whose modules a test's script can import."""

import contextlib
import mimetypes
import pathlib
from urllib.parse import urlsplit

from app.dashboard.templates import STATIC
from tests.e2e.browser import tabs

ORIGIN = "http://127.0.0.1:9"  # nothing listens there: every request is answered by `answer`


def open_modules(open_page, folder=STATIC):
    """Return a tab at ORIGIN that has the folder's files at its root."""
    tab = open_page(ORIGIN)

    def answer(route):
        path = pathlib.Path(folder) / urlsplit(route.request.url).path.lstrip("/")
        if path.is_file():
            route.fulfill(body=path.read_bytes(), content_type=mimetypes.guess_type(path.name)[0])
        else:
            route.fulfill(body="<!doctype html><title>test</title>", content_type="text/html")

    tab.page.route(f"{ORIGIN}/**", answer)
    tab.goto("/page")
    return tab


@contextlib.contextmanager
def module_page(chromium, folder=STATIC):
    """Yield Playwright's page of such a tab: for all tests of a file that run modules by themselves."""
    with tabs(chromium) as open_page:
        yield open_modules(open_page, folder).page
