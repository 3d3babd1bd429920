"""What attackers try with a browser: words that are markup, other sites' forms and frames, forged calls, old sessions.

tests/integration/dashboard tries these route by route; here it is a browser, which runs scripts and sends cookies.
"""

import functools
import http.server
import json
import re
import threading

import httpx2
import pytest
from playwright.sync_api import expect

from tests.e2e.dashboard_crawl import crawl
from tests.e2e.dashboard_server import PASSWORD, dashboard_server, require
from tests.support.estimates import found_item, identified_item
from tests.support.waiting import PATIENCE_SECONDS

pytestmark = pytest.mark.slow

RUN = "document.documentElement.dataset.ran"
MARKUP = f"""<script>{RUN}="yes"</script><img src=x onerror='{RUN}="yes"'>"><b id="planted">"""
ATTRIBUTE = f"""" onmouseover="{RUN}='yes'" autofocus onfocus="{RUN}='yes'" x='"""
FORMULA = '=HYPERLINK("http://example.org")\'"<b id=planted>'


@pytest.fixture(scope="module")
def world(chromium, tmp_path_factory):
    """A study whose every free text is an attack."""
    world = dashboard_server(tmp_path_factory.mktemp("attacks"))
    try:
        fill(world)
        yield world
    finally:
        world.close()


def fill(world):
    admin = world.admin
    world.make_study(name=f"Pilot {MARKUP}", location_policy="keep")
    for name, role in (("olga", "owner"), ("vera", "viewer"), ("o'hara", "viewer")):
        world.make_staff(name, pilot=role)
    require(admin.post("/v1/staff", json={"name": "ada", "password": PASSWORD, "is_admin": True}))
    food = {
        "key": "hostile",
        "name": MARKUP,
        "aliases": [ATTRIBUTE],
        "group": FORMULA,
        "form": "whole",
        "reason": MARKUP,
    }
    food |= {"portions": [{"amount": 1, "measure": MARKUP, "mass_g": 30}]}
    density = {"g_per_ml": 0.8, "sd_g_per_ml": 0.1, "state": "raw", "kind": "bulk", "source": MARKUP}
    require(admin.post("/v1/foods", json=food | {"densities": [density]}))
    with world.enrol() as phone:
        require(admin.post("/v1/studies/pilot/participants", json={"code": "P002"}))
        code = require(admin.post("/v1/studies/pilot/participants/P002/enrolment-codes"))["code"]
        require(phone.post("/v1/enrolments", json={"code": code, "device_name": MARKUP, "model": ATTRIBUTE}))
        item = identified_item({"apple": 0.5, "hostile": 0.4}, none=0.1)
        meal = world.send_meal(phone, item, found_item(hint=None), location={"latitude": 48.2, "longitude": 16.4})
        first = world.meal(meal)["items"][0]["id"]
        world.say(meal, "set_food", item=first, food="hostile")
        world.say(meal, "comment", item=first, text=MARKUP)
        world.say(meal, "question", text=ATTRIBUTE + MARKUP)


def test_no_text_of_the_data_is_ever_markup_on_any_page(world, open_page):
    tab = open_page(world.address)
    tab.sign_in("ada", PASSWORD)
    seen = []

    def look(route):
        page = tab.page
        page.wait_for_load_state()
        for summary in page.locator("main details:not([open]) > summary").all():
            if summary.is_visible():
                summary.click()
        page.mouse.move(300, 300)
        assert page.evaluate(f"{RUN} ?? null") is None, route
        assert (
            page.locator("#planted, [onmouseover], [onerror], main script:not([type='application/json'])").count() == 0
        )
        if "document.documentElement.dataset.ran" in page.inner_text("main") or "planted" in page.inner_text("body"):
            seen.append(route)

    crawl(tab, "/dashboard", look)
    assert len(seen) > 8, seen  # it is shown, as text


EVIL = """<!doctype html><title>evil</title>
<form id="f" method="post" action="{target}/dashboard/studies/pilot/members"><input name="name" value="vera">
<input name="role" value="owner"></form><iframe id="frame" name="frame" src="{target}/dashboard"></iframe>
<p id="done"></p>
<script>
const calls = [
  ["/dashboard/studies/pilot/members", "name=vera&role=owner"],
  ["/dashboard/staff", "name=mallory&password=correct+horse+battery"],
  ["/dashboard/sign-out", ""],
];
Promise.allSettled(calls.map(([path, body]) => fetch("{target}" + path, {{method: "POST", body, mode: "no-cors",
  credentials: "include", headers: {{"Content-Type": "application/x-www-form-urlencoded"}}}}))).then(async (all) => {{
    let read = "nothing";
    try {{ read = await (await fetch("{target}/dashboard", {{credentials: "include"}})).text(); }} catch {{ }}
    document.getElementById("done").textContent = JSON.stringify([all.map((one) => one.status), read]);
    document.getElementById("done").dataset.done = "yes";
  }});
</script>"""


class _Evil(http.server.BaseHTTPRequestHandler):
    def __init__(self, target, *arguments):
        self._target = target
        super().__init__(*arguments)

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.end_headers()
        self.wfile.write(EVIL.format(target=self._target).encode())

    def log_message(self, *_):
        """Nothing."""


@pytest.fixture(scope="module")
def evil(world):
    """Another site on this machine, by another port: SameSite knows no ports, so our cookies go along."""
    handler = functools.partial(_Evil, world.address)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_port
        server.shutdown()


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_other_site_changes_nothing_reads_nothing_and_frames_nothing(world, evil, chromium, host):
    context = chromium.new_context()
    page = context.new_page()
    page.goto(f"{world.address}/dashboard/sign-in")
    page.fill("#name", "olga")
    page.fill("#password", PASSWORD)
    page.click("button.main")
    page.wait_for_url(re.compile(r".*/dashboard$"))
    before = members(world)
    page.goto(f"http://{host}:{evil}/")
    page.wait_for_selector("#done[data-done]", state="attached")
    _, read = json.loads(page.inner_text("#done"))
    assert read == "nothing"
    assert "Sign out" not in page.frame("frame").content()
    with page.expect_navigation() as sent:
        page.evaluate("document.getElementById('f').submit()")
    # from the other host no cookie comes along: nobody is signed in
    assert sent.value.status == 403 or "/sign-in" in page.url
    assert members(world) == before
    assert {one["name"] for one in require(world.admin.get("/v1/staff"))["items"]} >= {"olga", "vera"}
    assert "mallory" not in world.admin.get("/v1/staff").text
    page.goto(f"{world.address}/dashboard")
    expect(page.get_by_role("button", name="Sign out")).to_have_count(1)  # still signed in
    context.close()


def members(world):
    rows = require(world.admin.get("/v1/studies/pilot/members"))["items"]
    return {row["name"]: row["role"] for row in rows}


FORGED = """async ([path, fields]) => {
  const answer = await fetch(path, {method: "POST", body: new URLSearchParams(fields), redirect: "manual"});
  return answer.status;
}"""


def test_viewers_pages_have_no_controls_and_forged_calls_are_refused(world, open_page):
    tab = open_page(world.address)
    tab.expect("status of 40[34]")
    tab.sign_in("vera", PASSWORD)
    controls = []

    def look(route):
        if "{study}" in route:
            working = "main form[method=post] :is(button, input:not([type=hidden]), select, textarea):enabled"
            controls.extend((route, one) for one in tab.page.locator(working).all_inner_texts())

    visited, _ = crawl(tab, "/dashboard", look, only=lambda path: "/studies/" in path)
    assert controls == []
    assert len([route for route in visited if "{study}" in route]) > 4
    meal = require(world.admin.get("/v1/meals", params={"study": "pilot"}))["items"][0]["id"]
    item = world.meal(meal)["items"][0]
    study = "/dashboard/studies/pilot"
    before = members(world), world.meal(meal), require(world.admin.get("/v1/studies/pilot"))
    forged = {
        f"{study}/members": {"name": "vera", "role": "owner"},
        f"{study}/settings": {"name": "Mine", "version": "1"},
        f"{study}/enrol": {"participants": "P001"},
        f"{study}/participants": {"code": "P999"},
        f"{study}/participants/P001/withdrawal": {"code": "P001"},
        f"{study}/meals/P001/{meal}/events": {"kind": "reject", "item": item["id"], "version": "1"},
        f"{study}/meals/P001/{meal}/erasure": {"code": "P001"},
        "/dashboard/staff": {"name": "mallory", "password": PASSWORD},
    }
    answers = {path: tab.page.evaluate(FORGED, [path, fields]) for path, fields in forged.items()}
    assert set(answers.values()) <= {403, 404}, answers
    assert (members(world), world.meal(meal), require(world.admin.get("/v1/studies/pilot"))) == before


def test_ended_session_leads_every_next_step_to_the_form_and_back_again(world, open_page):
    tab = open_page(world.address)
    tab.sign_in("vera", PASSWORD, "/dashboard/studies/pilot/participants")
    (cookie,) = tab.page.context.cookies()
    assert (cookie["httpOnly"], cookie["sameSite"], cookie["path"]) == (True, "Lax", "/dashboard")
    assert tab.page.evaluate("document.cookie") == ""
    other = require(
        httpx2.post(
            f"{world.address}/v1/sessions", json={"name": "vera", "password": PASSWORD}, timeout=PATIENCE_SECONDS
        )
    )["token"]
    changed = {"current_password": PASSWORD, "new_password": PASSWORD + " 2"}
    answer = httpx2.post(
        f"{world.address}/v1/sessions/current/password",
        headers={"Authorization": f"Bearer {other}"},
        json=changed,
        timeout=PATIENCE_SECONDS,
    )
    assert answer.status_code in (200, 204), answer.text  # which ends all sessions of hers
    tab.page.get_by_role("navigation", name="Study").get_by_role("link", name="Settings").click()
    tab.page.wait_for_url(re.compile(r".*/dashboard/sign-in\?next="))
    tab.page.fill("#name", "vera")
    tab.page.fill("#password", PASSWORD + " 2")
    tab.page.click("button.main")
    tab.page.wait_for_url(re.compile(r".*/studies/pilot/settings$"))
