"""The foods in a browser: a search as one types, a correction previewed and saved; axe finds nothing serious."""

import re

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect

from tests.e2e.dashboard_server import PASSWORD, dashboard_server, require

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    server = dashboard_server(tmp_path_factory.mktemp("foods-pages"))
    body = {"name": "chief", "password": PASSWORD, "is_admin": True}
    try:
        require(server.admin.post("/v1/staff", json=body))
        yield server
    finally:
        server.close()


@pytest.fixture
def tab(served, open_page):
    opened = open_page(served.address)
    opened.sign_in("chief", PASSWORD, "/dashboard/foods")
    return opened


def assert_accessible(page):
    found = [one["id"] for one in Axe().run(page).response["violations"] if one["impact"] in ("serious", "critical")]
    assert found == []


def test_rows_and_address_follow_what_is_typed_and_the_address_alone_shows_them_again(tab):
    page = tab.page
    page.locator("#q").press_sequentially("spagetti")
    page.wait_for_url(re.compile(r".*/dashboard/foods\?q=spagetti$"))
    first = page.locator("#found tbody a").first
    expect(first).to_contain_text("paghetti")
    name = first.inner_text()
    page.reload()
    expect(first).to_have_text(name)
    expect(page.locator("#q")).to_have_value("spagetti")
    assert_accessible(page)
    first.press("Enter")
    page.wait_for_url(re.compile(r".*/dashboard/foods/[a-z-]+$"))
    expect(page.locator("h1")).to_have_text(name)
    assert_accessible(page)


def test_correction_is_previewed_by_enter_and_saved(tab):
    page = tab.page
    tab.goto("/dashboard/foods/apple/edit")
    assert_accessible(page)
    page.fill("#nutrient-401", "9.5")
    page.locator("#nutrient-401").press("Enter")
    page.wait_for_selector("#preview")
    expect(page.locator(".preview")).to_contain_text("9.5")
    page.fill("#reason", "analysed")
    page.get_by_role("button", name="Save").click()
    page.wait_for_url(re.compile(r".*/dashboard/foods/apple$"))
    expect(page.locator("#told")).to_contain_text("Version 2 is in force")
