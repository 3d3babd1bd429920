"""Pictures of the pages for README and docs, from a sample study that somebody looks at.

    tada demo --browse --port 8080                      # until it says that all is measured
    python -m tools.screenshots http://127.0.0.1:8080 olga PASSWORD [--folder docs/pictures] [--only NAME]

Each is a WebP of at most MAX_BYTES; look at each before it is committed.
"""

import argparse
import io
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import httpx2
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from app.cli.demo_study import DAYS, STUDY, ZONE
from tests.e2e.browser import ARGUMENTS, CHROMIUM, SOFTWARE_3D

MAX_BYTES = 100_000
QUALITIES = (88, 82, 75, 68, 60, 50, 40)
WIDTH, HEIGHT = 1200, 800
PHONE: dict[str, Any] = {
    "viewport": {"width": 390, "height": 780},
    "device_scale_factor": 2,
    "color_scheme": "dark",
}
MOST_SKIPPED = 20  # items that are told in words come first
# of review.js: a key that comes sooner is taken for one that was meant for the item before
SETTLED_MS = 300
BASE = f"/dashboard/studies/{STUDY}"


@dataclass(frozen=True)
class Shot:
    """A picture. path: of the page. prepare: what is done on it first. clip: this element alone, or the window."""

    name: str
    path: str
    prepare: Callable[[Page], None] = lambda _: None
    clip: str | None = None
    options: dict[str, Any] = field(default_factory=dict)


def shots(meal: str, participant: str) -> list[Shot]:
    """What is pictured; meal: a photographed one with several foods."""
    today = datetime.now(ZoneInfo(ZONE)).date()
    one_meal = f"{BASE}/meals/{participant}/{meal}"
    return [
        Shot(
            "overview",
            f"{BASE}?from={today - timedelta(days=DAYS - 1)}&to={today}",
            charts,
            options={"viewport": {"width": WIDTH, "height": 1100}},
        ),
        Shot("meals", f"{BASE}/meals?origin=photographed", fold),
        Shot("meal", one_meal, options={"viewport": {"width": WIDTH, "height": 1050}}),
        Shot("meal-3d", one_meal, drawn, clip=".meal3d"),
        Shot("review", f"{BASE}/review", card),
        Shot("participant", f"{BASE}/participants/{participant}"),
        Shot("food", "/dashboard/foods/banana"),
        Shot("exports", f"{BASE}/exports"),
        Shot("phone", one_meal, options=PHONE),
    ]


def charts(page: Page) -> None:
    """Wait for the plots."""
    page.wait_for_selector("[data-chart] canvas")


def fold(page: Page) -> None:
    """Fold the filters."""
    page.click(".meals-more[open] > summary")


def card(page: Page) -> None:
    """Skip to the first item that was photographed, and wait for its picture."""
    page.wait_for_selector(".review-card:not([hidden])")
    for _ in range(MOST_SKIPPED):
        page.wait_for_timeout(SETTLED_MS)
        if page.locator(".review-card:not([hidden]) image").count():
            break
        page.keyboard.press("s")
    page.wait_for_timeout(2000)


def drawn(page: Page) -> None:
    """Wait for the foods in 3D."""
    page.wait_for_selector("canvas[data-frames]")
    page.locator(".meal3d").scroll_into_view_if_needed()
    page.wait_for_timeout(1500)


def main() -> int:
    """Take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("address", help="Of the server, http://127.0.0.1:8080.")
    parser.add_argument("name")
    parser.add_argument("password")
    parser.add_argument("--folder", type=Path, default=Path("docs/pictures"))
    parser.add_argument("--only", help="This picture alone.")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    meal, participant = richest_meal(arguments.address, arguments.name, arguments.password)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=[*ARGUMENTS, *SOFTWARE_3D]
        )
        for shot in shots(meal, participant):
            if arguments.only in (None, shot.name):
                take(browser, arguments, shot)
        browser.close()
    return 0


def richest_meal(address: str, name: str, password: str) -> tuple[str, str]:
    """The photographed meal with most foods that are known, confirmed ones first: its id and participant."""
    with httpx2.Client(base_url=address, timeout=60) as client:
        session = (
            client.post("/v1/sessions", json={"name": name, "password": password})
            .raise_for_status()
            .json()
        )
        client.headers["Authorization"] = f"Bearer {session['token']}"
        params = {"study": STUDY, "origin": "photographed"}
        meals = client.get("/v1/meals", params=params).raise_for_status().json()["items"]
        client.delete("/v1/sessions/current")
    best = max(meals, key=lambda meal: (meal["status"] == "confirmed", meal["item_count"]))
    return best["id"], best["participant"]


def take(browser: Any, arguments: argparse.Namespace, shot: Shot) -> None:
    """One picture, signed in, printed with its size."""
    context = browser.new_context(
        **{"viewport": {"width": WIDTH, "height": HEIGHT}, **shot.options}
    )
    page = context.new_page()
    page.set_default_timeout(60_000)
    page.goto(f"{arguments.address}/dashboard/sign-in")
    page.fill("#name", arguments.name)
    page.fill("#password", arguments.password)
    page.click("button.main")
    page.wait_for_url(f"{arguments.address}/dashboard")
    page.goto(arguments.address + shot.path)
    page.wait_for_load_state()
    shot.prepare(page)
    page.wait_for_timeout(500)  # pictures that come late
    png = page.locator(shot.clip).first.screenshot() if shot.clip else page.screenshot()
    context.close()
    content = small(png)
    path = arguments.folder / f"{shot.name}.webp"
    path.write_bytes(content)
    print(f"{path}: {len(content) / 1000:.0f} kB")


def small(png: bytes) -> bytes:
    """A WebP of at most MAX_BYTES, as good as that allows."""
    with Image.open(io.BytesIO(png)) as image:
        picture = image.convert("RGB")
    for quality in QUALITIES:
        buffer = io.BytesIO()
        picture.save(buffer, "WEBP", quality=quality, method=6)
        if buffer.tell() <= MAX_BYTES:
            return buffer.getvalue()
    raise SystemExit(f"the picture has more than {MAX_BYTES} bytes at every quality")


if __name__ == "__main__":
    sys.exit(main())
