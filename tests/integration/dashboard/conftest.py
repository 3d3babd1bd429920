"""The dashboard as a browser without scripts uses it: cookies, forms, the origin of requests."""

import re
from html.parser import HTMLParser

import pytest

from tests.integration.conftest import meal_metadata
from tests.integration.people.people import PASSWORD, make_staff
from tests.support import estimates
from tests.support.photographs import pair

BROWSER = {"Accept": "text/html,application/xhtml+xml", "Sec-Fetch-Site": "same-origin"}


class Figures(HTMLParser):
    """All `<data value>` of a page, in their order."""

    def __init__(self):
        super().__init__()
        self.values = []

    def handle_starttag(self, tag, attributes):
        if tag == "data":
            self.values.append(float(dict(attributes)["value"]))


class Browser:
    """A person who is signed in, by name and password."""

    def __init__(self, client, name, password=PASSWORD):
        self.client, self.name = client, name
        answer = self.post("/dashboard/sign-in", name=name, password=password)
        assert answer.status_code == 303, answer.text
        self.cookies = dict(answer.cookies)
        client.cookies.clear()

    def request(self, method, path, *, headers=None, data=None, params=None):
        cookies = "; ".join(f"{name}={value}" for name, value in getattr(self, "cookies", {}).items())
        sent = BROWSER | ({"Cookie": cookies} if cookies else {}) | (headers or {})
        answer = self.client.request(
            method, path, headers=sent, data=data, params=params or None, follow_redirects=False
        )
        self.client.cookies.clear()
        if hasattr(self, "cookies"):
            self.cookies |= dict(answer.cookies)
        return answer

    def get(self, path, *, headers=None, **params):
        return self.request("GET", path, headers=headers, params=params)

    def post(self, path, *, headers=None, **fields):
        return self.request("POST", path, headers=headers, data=fields)

    def page(self, path, **params):
        """The HTML of a page that must be there."""
        answer = self.get(path, **params)
        assert answer.status_code == 200, (path, answer.status_code, answer.text[:2000])
        return answer.text


def figures_of(html):
    """The numbers that a page shows, whole, in their order."""
    parser = Figures()
    parser.feed(html)
    return parser.values


def text_of(html):
    """What is read on a page, blanks folded."""
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html))


@pytest.fixture
def sign_in_browser(client, admin):
    """A browser of a staff member with roles by study: sign_in_browser("ann", pilot="viewer")."""

    def sign_in(name, *, is_admin=False, **roles):
        make_staff(client, admin, name, is_admin=is_admin, **roles)
        return Browser(client, name)

    return sign_in


@pytest.fixture
def owner(enrol, sign_in_browser):
    """The browser of an owner of the study, which P001 is in."""
    enrol()
    return sign_in_browser("olga", pilot="owner")


@pytest.fixture
def viewer(enrol, sign_in_browser):
    enrol()
    return sign_in_browser("vera", pilot="viewer")


@pytest.fixture
def meal_of(state, enrol):
    """A meal of P001 (or another), estimated if items or changes of the estimate are given; its id."""
    phones = {}

    def meal_of(*items, participant="P001", hint="apple", captured_at="2026-11-20T12:30:00+08:00", **changes):
        phone = phones.get(participant) or phones.setdefault(participant, enrol(participant))
        hints = [{"point": [30, 20], "food": hint}] if hint else None
        body = meal_metadata(hints=hints, captured_at=captured_at)
        assert phone.post(pair(len(phones)), body).status_code == 202
        if items or changes:
            estimates.save(state, body["id"], *items, **changes)
        return body["id"]

    return meal_of
