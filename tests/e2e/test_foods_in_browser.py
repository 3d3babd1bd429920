"""The foods in a browser: a search as one types, a correction previewed and saved."""

import re

import pytest
from playwright.sync_api import expect

from tests.e2e.dashboard_server import PASSWORD, require


@pytest.fixture(scope="module")
def chief(served):
    require(served.admin.post("/v1/staff", json={"name": "chief", "password": PASSWORD, "is_admin": True}))


@pytest.fixture
def tab(served, chief, open_page):
    opened = open_page(served.address)
    opened.sign_in("chief", PASSWORD, "/dashboard/foods")
    return opened


@pytest.mark.slow
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
    first.press("Enter")
    page.wait_for_url(re.compile(r".*/dashboard/foods/[a-z-]+$"))
    expect(page.locator("h1")).to_have_text(name)


def test_correction_is_previewed_by_enter_and_saved(tab):
    page = tab.page
    tab.goto("/dashboard/foods/apple/edit")
    page.fill("#nutrient-401", "9.5")
    page.locator("#nutrient-401").press("Enter")
    page.wait_for_selector("#preview")
    expect(page.locator(".preview")).to_contain_text("9.5")
    page.fill("#reason", "analysed")
    page.get_by_role("button", name="Save").click()
    page.wait_for_url(re.compile(r".*/dashboard/foods/apple$"))
    expect(page.locator("#told")).to_contain_text("Version 2 is in force")
