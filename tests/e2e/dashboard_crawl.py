"""Every page of the dashboard that links lead to, one of each route: for tests that look at all of them."""

import re
from urllib.parse import urlsplit

from app.people.access.page_rules import OPEN_PAGES, PAGES

LINKS = """() => [...document.querySelectorAll('a[href], img[src], [hx-get], form[method=get]')].map((one) => ({
  href: new URL(['href', 'src', 'hx-get', 'action'].map((name) => one.getAttribute(name)).find((value) => value) ?? '',
    document.baseURI).href,
  isPage: one.tagName.toLowerCase() === 'a' && !one.hasAttribute('download'),
}))"""


def routes():
    """The paths that a browser may get, the plainest first."""
    paths = [path for method, path in (*PAGES, *OPEN_PAGES) if method == "GET"]
    return sorted(paths, key=lambda path: (path.count("{"), path))


def route_of(path):
    """The route that answers this path; None: it is none of the dashboard's."""
    for route in routes():
        if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", route.replace(".", r"\.")), path):
            return route
    return None


def crawl(watched, start="/dashboard", look=None, only=lambda path: True):
    """Visit one page of each route that is linked, from `start` on; look(route): at each of them while it is open.

    watched: signed in. Returns the routes that were visited, with the path of each, and all routes that were linked.
    """
    visited, linked, waiting = {}, {route_of(start)}, [start]
    while waiting:
        path = waiting.pop(0)
        route = route_of(urlsplit(path).path)
        if route in visited:
            continue
        asked = watched.page.request.get(watched.address + path)
        assert asked.status == 200, (path, asked.status)
        if not asked.headers["content-type"].startswith("text/html"):
            continue  # not gone to: Chromium's own page around a picture breaks our policy, and says so
        watched.goto(path)
        visited[route] = path
        if look is not None:
            look(route)
        for link in watched.page.evaluate(LINKS):
            parts = urlsplit(link["href"])
            there = route_of(parts.path) if f"{parts.scheme}://{parts.netloc}" == watched.address else None
            if there is None or not only(parts.path):
                continue
            linked.add(there)
            if link["isPage"] and there not in visited:
                waiting.append(parts.path + (f"?{parts.query}" if parts.query else ""))
    return visited, linked
