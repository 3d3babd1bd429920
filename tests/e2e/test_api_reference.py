"""The API's document in a browser: drawn without another host, and an operation opens."""

import pytest

from tests.e2e.dashboard_server import dashboard_server

pytestmark = pytest.mark.slow


def test_document_is_drawn_with_nothing_asked_of_others(chromium, open_page, tmp_path):
    served = dashboard_server(tmp_path)
    try:
        watched = open_page(served.address)
        watched.goto("/docs")
        operation = watched.page.locator(".opblock-summary-path").filter(has_text="meals").first
        operation.click()
        watched.page.locator(".opblock-body", has_text="Parameters").first.wait_for()
        watched.require_quiet()
    finally:
        served.close()
