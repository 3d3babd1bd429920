"""A researcher's way through a sample study in a real browser, and every page's accessibility in three looks.

The study is real: photographs measured by a worker, days told by phones, all over HTTP (demo_study.py). Each page
must be quiet: no error in the console, no request of another host (browser.py).
"""

import csv
import io
import math
import re
from dataclasses import dataclass

import cv2
import httpx2
import numpy as np
import pytest

from app.cli.demo import PEOPLE, PLATES
from app.cli.demo_study import STUDY, Photographed, SampleStudy, declare_days, make_study, photograph_meals, settle
from tests.e2e.browser import violations
from tests.e2e.dashboard_crawl import crawl, routes
from tests.e2e.dashboard_server import require
from tests.e2e.processes import Server
from tests.support.waiting import wait_until

pytestmark = pytest.mark.slow

MEALS = (
    Photographed(PLATES["rice"], names=True, then="confirm"),
    Photographed(PLATES["apple"]),
    Photographed(PLATES["salad"]),
    Photographed(PLATES["apple"], is_cropped=True),
)
DAYS = 4
SEED = 3
SAMPLE = f"/dashboard/studies/{STUDY}"
MADE_SECONDS = 120
GPU = "GPU stall due to ReadPixels"  # what drawing by software costs
OF_STUDY = "/dashboard/studies/{study}"
MEAL = f"{OF_STUDY}/meals/{{participant}}/{{meal_id}}"
# parts of pages that scripts ask for, forms' targets, and where one is led: no link leads there
PARTS = {
    "/",
    "/dashboard/sign-in",
    "/dashboard/sign-in/return",
    f"{OF_STUDY}/adequacy/figures",
    f"{OF_STUDY}/blind/{{item}}/picture",
    f"{OF_STUDY}/changed-meals",
    f"{OF_STUDY}/exports/list",
    f"{OF_STUDY}/exports/table",
    f"{OF_STUDY}/foods",
    f"{OF_STUDY}/releases-list",
    f"{OF_STUDY}/releases/{{name}}/check",
    f"{OF_STUDY}/releases/{{name}}/state",
    f"{OF_STUDY}/remeasurement-plan",
    f"{OF_STUDY}/remeasurements/{{remeasurement}}/state",
    f"{OF_STUDY}/review/{{participant}}/{{meal_id}}",
    f"{MEAL}/state",
    f"{OF_STUDY}/{{rest:path}}",
}


@dataclass
class World:
    """A server with its worker, and the sample study in it. meals: ids by what is photographed."""

    server: Server
    admin: httpx2.Client
    study: SampleStudy

    @property
    def address(self):
        return self.server.address

    def password(self, role):
        return next((one.name, one.password) for one in self.study.accounts if one.role == role)

    def meal(self, number):
        """The id of one of MEALS, its participant, and what the API tells of it."""
        _, meal_id, phone = self.study.measured[number]
        participant = next(code for code, one in self.study.phones.items() if one is phone)
        return meal_id, participant, require(self.admin.get(f"/v1/meals/{meal_id}"))


@pytest.fixture(scope="module")
def world(chromium, tmp_path_factory):
    server = Server(
        tmp_path_factory.mktemp("walk"),
        TADA_SIGN_IN_ATTEMPTS_PER_MINUTE="1000",
        TADA_MIN_FREE_BYTES="0",
        TADA_EXPORT_MIN_FREE_BYTES="0",
        TADA_WEBHOOK_ALLOW_LOOPBACK="true",
    )
    server.place_prepared_database()
    server.start()
    try:
        server.wait_until_ready()
        token = server.create_admin("boss")
        headers = {"Authorization": f"Bearer {token}"}
        with httpx2.Client(base_url=server.address, headers=headers, timeout=60) as admin:
            study = make_study(admin, PEOPLE[:3])
            photograph_meals(study, SEED, MEALS)
            declare_days(study, SEED, DAYS)
            assert settle(study, admin) == {"confirmed": 1, "estimated": 1, "needs_review": 1, "failed": 1}
            yield World(server, admin, study)
            study.close()
    finally:
        server.stop()


def menu(page, label):
    """Follow the study's menu."""
    link = page.get_by_role("navigation", name="Study").get_by_role("link", name=label, exact=True)
    path = link.get_attribute("href")
    link.click()
    page.wait_for_url(f"**{path}*", wait_until="load")


def figures(page, within="main"):
    return [float(value) for value in page.eval_on_selector_all(f"{within} data", "all => all.map((d) => d.value)")]


def test_researcher_walks_from_sign_in_to_sign_out(world, open_page, tmp_path):
    tab = open_page(world.address, accept_downloads=True, reduced_motion="reduce")
    tab.expect(GPU)
    page = tab.page
    tab.sign_in(*world.password("owner"))
    page.get_by_role("link", name="Sample study").click()
    page.wait_for_url(f"**{SAMPLE}", wait_until="load")

    overview = require(world.admin.get(f"/v1/studies/{STUDY}/overview"))
    assert page.url.endswith(SAMPLE)
    shown = figures(page)
    assert {overview["participants"]["everybody"], overview["completeness"]["closed"]} <= set(shown)
    page.wait_for_selector("[data-chart] canvas")

    menu(page, "Meals")
    assert_pictures_are_there(page)
    rice_id, rice_person, rice = world.meal(0)
    page.click(f'main a[href$="/meals/{rice_person}/{rice_id}"] >> nth=0')
    page.wait_for_url(f"**/{rice_id}", wait_until="load")
    assert_meal_is_shown(page, rice)
    assert_foods_are_drawn(page)

    menu(page, "Participants")
    page.get_by_role("link", name="P001", exact=True).click()
    page.wait_for_url("**/participants/P001", wait_until="load")
    days = require(world.admin.get("/v1/days", params={"study": STUDY, "participant": "P001"}))["items"]
    for day in days:
        if day["energy_kcal"] is not None:
            assert any(math.isclose(day["energy_kcal"], one, rel_tol=1e-9) for one in figures(page))

    menu(page, "Exports")
    assert_file_is_the_apis(world, page)

    page.get_by_role("button", name="Sign out").click()
    page.wait_for_url(re.compile(r".*/dashboard/sign-in$"))
    tab.goto(f"{SAMPLE}/meals")
    assert "/dashboard/sign-in?next=" in page.url
    assert page.context.cookies() == []


def assert_pictures_are_there(page):
    """Each photograph of the gallery has come, with words for who does not see it."""
    pictures = page.locator("main img")
    assert pictures.count() >= len(MEALS)
    for number in range(pictures.count()):
        picture = pictures.nth(number)
        picture.scroll_into_view_if_needed()
        assert picture.evaluate("async (one) => { await one.decode(); return one.naturalWidth; }") > 100
        assert picture.get_attribute("alt")


def assert_meal_is_shown(page, meal):
    shown = figures(page)
    assert len(meal["items"]) == 3
    for item in meal["items"]:
        for name in ("volume_ml", "mass_g", "density_g_per_ml"):
            assert any(math.isclose(item[name], one, rel_tol=1e-9) for one in shown), (name, item[name])
        assert item["food"]["name"] in page.inner_text(f"#item-{item['id']}")


def assert_foods_are_drawn(page):
    """The 3D view shows something in colours: what lies on the plate."""
    canvas = page.locator("canvas[data-frames]")
    canvas.scroll_into_view_if_needed()

    def coloured_pixels():
        pixels = cv2.imdecode(np.frombuffer(page.locator(".meal3d-view").screenshot(), np.uint8), cv2.IMREAD_COLOR)
        spread = pixels.max(axis=2).astype(int) - pixels.min(axis=2)
        return np.count_nonzero(spread > 40)

    wait_until(lambda: coloured_pixels() > 2000, "a view in colours")


def assert_file_is_the_apis(world, page):
    page.select_option("#format", "csv")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download now").click()
    got = list(csv.DictReader(io.StringIO(download.value.path().read_text("utf-8"))))
    params = {"study": STUDY, "format": "csv"}
    expected = list(csv.DictReader(io.StringIO(world.admin.get("/v1/records", params=params).text)))
    assert len(got) == len(expected) > 20
    assert got == expected
    assert re.fullmatch(r"[\w.-]+\.csv", download.value.suggested_filename)


def measured_meal(admin):
    """The page of a meal that has a run: the first one that links lead to may have none, by the time of the day."""
    listed = admin.get("/v1/meals", params={"study": "sample", "origin": "photographed", "limit": 50}).json()["items"]
    meal = next(one for one in listed if one["status"] in {"estimated", "needs_review", "confirmed"})
    return f"/dashboard/studies/sample/meals/{meal['participant']}/{meal['id']}"


def test_every_page_is_linked_and_accessible_in_light_dark_and_on_a_phone(world, open_page):
    require(world.admin.post("/v1/staff", json={"name": "alma", "password": "correct horse battery", "is_admin": True}))
    fill_lists(world.admin)
    tab = open_page(world.address, reduced_motion="reduce")
    tab.expect(GPU)
    tab.sign_in("alma", "correct horse battery")
    page, found = tab.page, []

    def look(route):
        page.wait_for_load_state("networkidle") if route.count("{") < 3 else page.wait_for_load_state()
        for summary in page.locator("main details:not([open]) > summary").all():
            if summary.is_visible():
                summary.click()
        for scheme, width in (("light", 1280), ("dark", 390)):
            page.emulate_media(color_scheme=scheme)
            page.set_viewport_size({"width": width, "height": 900})
            rules = {"rules": {"target-size": {"enabled": width < 1280}}}
            found.extend((route, scheme, width, *violation) for violation in violations(page, **rules))
        page.set_viewport_size({"width": 1280, "height": 900})

    visited, linked = crawl(tab, "/dashboard", look)
    linked |= crawl(tab, measured_meal(world.admin), look, only=lambda path: "/artefacts/" in path)[1]
    assert not found, "\n".join(str(one) for one in found)
    assert set(routes()) - linked - PARTS == set()
    assert len(visited) > 15


def fill_lists(admin):
    """A webhook, a remeasurement, a release and an export that is made, so that their pages are there to be linked."""
    study = f"/v1/studies/{STUDY}"
    hook = {"url": "http://127.0.0.1:9/hook", "events": ["meal.confirmed"]}
    require(admin.post(f"{study}/webhooks", json=hook))
    require(admin.post(f"{study}/releases", json={"name": "baseline", "note": "Of the walk"}))
    again = require(admin.post(f"{study}/remeasurements", json={"limit": 1}))["id"]
    stopped = admin.post(f"{study}/remeasurements/{again}/stop")
    assert stopped.is_success or stopped.json()["code"] == "remeasurement_done", stopped.text
    export = require(admin.post(f"{study}/exports", json={"rows": "items", "format": "csv"}))["id"]

    def are_made():
        release = require(admin.get(f"{study}/releases/baseline"))
        return require(admin.get(f"{study}/exports/{export}"))["state"] == "done" and release.get("files")

    wait_until(are_made, "the export and the release", interval_seconds=0.5, patience_seconds=MADE_SECONDS)
