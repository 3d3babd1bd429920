"""Signing in with a code of an app, and with an institution's account at a provider of another site, in a browser."""

import re
import time

import pytest

from tests.e2e.browser import require_legible
from tests.e2e.dashboard_server import PASSWORD, dashboard_server
from tests.support.authenticator import code_of
from tests.support.identity_provider import CLIENT, FILTER, SECRET, identity_provider

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings(FILTER)]

ACCOUNT = "**/dashboard/account"
SUBJECT = "olga@hospital.example"


def say_who_one_is(tab, subject):
    """At the provider, whose page asks for a style of the internet's."""
    tab.expect("localhost|jsdelivr")
    page = tab.page
    page.wait_for_url(re.compile(r"http://localhost:.*/oauth2/authorize"))
    page.get_by_placeholder("sub").fill(subject)
    page.get_by_role("button", name="Authorize").click()
    page.wait_for_url(f"{tab.address}/**")
    tab.outside.clear()


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    with identity_provider() as provider:
        server = dashboard_server(
            tmp_path_factory.mktemp("sign-in"),
            TADA_OIDC_ISSUER=provider.address,
            TADA_OIDC_CLIENT_ID=CLIENT,
            TADA_OIDC_CLIENT_SECRET=SECRET,
        )
        try:
            server.make_study()
            for name in ("olga", "rene"):
                server.make_staff(name, pilot="owner")
            yield server
        finally:
            server.close()


def test_code_of_an_app_is_turned_on_and_asked_for(world, open_page):
    tab = open_page(world.address)
    tab.sign_in("olga", PASSWORD, "/dashboard/account")
    page = tab.page
    require_legible(page, "account")
    page.get_by_role("link", name="Turn them on").click()
    secret = page.locator(".secret").inner_text()
    require_legible(page, "totp")
    step = int(time.time()) // 30
    page.get_by_label("Code that the app shows").fill(code_of(secret, step))
    page.get_by_role("button", name="Turn them on").click()
    page.wait_for_url(ACCOUNT)
    assert "needs a code" in page.locator("main").inner_text()
    require_legible(page, "account-with-codes")

    again = open_page(world.address)
    again.expect("401|422")
    again.goto("/dashboard/sign-in?next=/dashboard/account")
    page = again.page
    require_legible(page, "sign-in")
    page.get_by_label("Name").fill("olga")
    page.get_by_label("Password").fill(PASSWORD)
    page.get_by_role("button", name="Sign in", exact=True).click()
    page.get_by_label("Code that your app shows").wait_for()
    require_legible(page, "sign-in-code")
    # the next step's code, which is accepted now and, on a slow machine, later
    page.get_by_label("Code that your app shows").fill(code_of(secret, step + 1))
    page.keyboard.press("Enter")
    page.wait_for_url(ACCOUNT)

    page.get_by_label("Code that your app shows").fill("000000")
    page.get_by_label("Your password", exact=True).first.fill(PASSWORD)
    page.get_by_role("button", name="Turn them off").click()
    page.get_by_text("This code is wrong").wait_for()
    require_legible(page, "account-wrong-code")


def test_account_of_the_institution_is_linked_and_signs_in(world, open_page):
    tab = open_page(world.address)
    tab.sign_in("rene", PASSWORD, "/dashboard/account")
    page = tab.page
    page.get_by_role("button", name="Link it").click()
    say_who_one_is(tab, SUBJECT)
    page.get_by_role("button", name="End the link").wait_for()
    require_legible(page, "account-linked")

    again = open_page(world.address)
    again.goto("/dashboard/sign-in?next=/dashboard/account")
    again.page.get_by_role("button", name="Sign in with your institution").click()
    say_who_one_is(again, SUBJECT)
    again.page.wait_for_url(ACCOUNT)
    assert "rene" in again.page.locator("main").inner_text()


def test_account_that_nobody_linked_is_told_what_to_do(world, open_page):
    tab = open_page(world.address)
    tab.expect("401")
    tab.goto("/dashboard/sign-in")
    page = tab.page
    page.get_by_role("button", name="Sign in with your institution").click()
    say_who_one_is(tab, "stranger")
    page.get_by_text("is not linked to one here").wait_for()
    require_legible(page, "unlinked")
    page.get_by_role("link", name="Sign in").click()
    page.get_by_label("Password").wait_for()
