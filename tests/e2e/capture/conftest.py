"""A phone's browser on the study "capture"."""

import pytest

from tests.e2e.browser import tabs

PHONE = {"viewport": {"width": 390, "height": 844}, "permissions": ["camera", "microphone"]}


@pytest.fixture(scope="module")
def browser(chromium):
    """The browser of a phone; test_capture_joining.py has one of its own, whose camera sees a card."""
    return chromium


@pytest.fixture
def open_phone(served, browser):
    """open_phone(address, **options): a tab of a fresh profile that must be quiet at the end."""
    with tabs(browser) as open_tab:

        def open_phone(address=served.address, **options):
            tab = open_tab(address, **(PHONE | options))
            tab.expect(r"status of 404.*/upload\)$")  # an upload in pieces is asked for before it is begun
            return tab

        yield open_phone
