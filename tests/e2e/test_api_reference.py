"""The API's document in a browser: drawn without another host, and an operation opens."""

import pytest


@pytest.mark.slow
def test_document_is_drawn_with_nothing_asked_of_others(served, open_page):
    page = open_page(served.address).page
    page.goto(f"{served.address}/docs")
    page.locator(".opblock-summary-path").filter(has_text="meals").first.click()
    page.locator(".opblock-body", has_text="Parameters").first.wait_for()
