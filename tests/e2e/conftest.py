"""Fixtures of the tests that walk through the pages in a browser."""

import pytest

from tests.e2e.browser import chromium, open_page
from tests.e2e.dashboard_server import dashboard_server

__all__ = ["chromium", "open_page"]


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """A server with the study "pilot" and its reviewer "ann"."""
    server = dashboard_server(tmp_path_factory.mktemp("served"))
    try:
        server.make_study()
        server.make_staff("ann", pilot="reviewer")
        yield server
    finally:
        server.close()


@pytest.fixture(scope="module")
def phone(served):
    """The phone of P001 in that study."""
    with served.enrol() as phone:
        yield phone
