"""The 3D view of a rendered ball beside the board, in a browser that draws by software, under the pages' own policy."""

import functools
import http.server
import json
import pathlib
import re
import shutil
import threading

import cv2
import numpy as np
import pytest
from playwright.sync_api import expect

import app.dashboard
from app.dashboard.answers import CONTENT_SECURITY_POLICY
from tests.e2e.measured_ball import BALL, measured_ball

pytestmark = pytest.mark.slow  # beyond the gate

STATIC = pathlib.Path(app.dashboard.__file__).parent / "static"
PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>A meal</title>
<link rel="icon" href="/static/icon.svg"><link rel="stylesheet" href="/static/app.css">
<script type="module" src="/static/meal3d.js"></script></head><body><main>
<div id="here" data-scene="/{scene}" data-fallback="/points.jpg"
 data-names='["&lt;img src=x onerror=alert(1)&gt; orange"]'></div>
</main></body></html>"""
DRAWN = "Number(document.querySelector('canvas')?.dataset.frames ?? 0)"
REST = """new Promise((done) => {
  let left = 20; // frames
  const next = () => ((left -= 1) ? requestAnimationFrame(next) : done());
  next();
})"""


class _Files(http.server.SimpleHTTPRequestHandler):
    def guess_type(self, path):
        types = {".js": "text/javascript", ".css": "text/css", ".json": "application/json", ".svg": "image/svg+xml"}
        return types.get(pathlib.Path(path).suffix) or super().guess_type(path)

    def end_headers(self):
        self.send_header("Content-Security-Policy", CONTENT_SECURITY_POLICY)
        super().end_headers()

    def log_message(self, *_):
        """Nothing."""


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """A server of the pages' files, of pages with a scene, and of what a run left."""
    folder = tmp_path_factory.mktemp("site")
    for artefact in measured_ball()[1].artefacts:
        (folder / artefact.name).write_bytes(artefact.content)
    (folder / "meal.html").write_text(PAGE.format(scene="scene.json"))
    (folder / "none.html").write_text(PAGE.format(scene="gone.json"))
    scene = json.loads((folder / "scene.json").read_text())
    del scene["board"]  # as of a meal by a rig
    (folder / "bare.json").write_text(json.dumps(scene))
    (folder / "bare.html").write_text(PAGE.format(scene="bare.json"))
    shutil.copytree(STATIC, folder / "static")
    handler = functools.partial(_Files, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def wait_until(page, expression):
    """As wait_for_function, whose way of asking the pages' policy forbids."""
    page.evaluate(
        f"new Promise((done) => {{ const ask = () => ({expression}) ? done() : setTimeout(ask, 50); ask(); }})"
    )


def opened(open_page, address, path="/meal.html", **options):
    watched = open_page(address, reduced_motion="reduce", **options)
    watched.expect("GPU stall due to ReadPixels")  # what drawing by software costs
    watched.goto(path)
    watched.page.wait_for_selector("canvas[data-frames]")
    watched.page.evaluate(REST)
    return watched.page


def picture(page):
    page.evaluate(REST)
    pixels = cv2.imdecode(np.frombuffer(page.locator(".meal3d-view").screenshot(), np.uint8), cv2.IMREAD_COLOR)
    return pixels.astype(np.int64)


def orange(page):
    """Pixels of the ball's colours: red well over blue."""
    pixels = picture(page)
    return np.count_nonzero(pixels[..., 2] - pixels[..., 0] > 60)


def test_food_and_board_are_drawn_and_told_in_a_table(open_page, address):
    page = opened(open_page, address)
    seen = picture(page)
    assert orange(page) > 3000
    assert np.count_nonzero(seen.max(axis=2) < 30) > 2000  # the board's dark squares
    name, volume, _, size = page.locator(".meal3d tbody tr").first.locator("th, td").all_inner_texts()
    assert float(re.match(r"(\d+) ml", volume)[1]) == pytest.approx(BALL.volume_ml, rel=0.12)
    assert [float(side) for side in re.findall(r"\d+", size)] == pytest.approx([66, 66, 66], abs=5)
    assert name == "1 · <img src=x onerror=alert(1)> orange"
    assert page.locator(".meal3d img").count() == 0


def test_keys_turn_and_zoom_and_bring_the_first_view_back(open_page, address):
    page = opened(open_page, address)
    first, size = picture(page), orange(page)
    page.focus("canvas")
    focused = picture(page)  # with the ring of the focus
    for _ in range(3):
        page.keyboard.press("+")
    assert orange(page) > 1.3 * size
    for _ in range(3):
        page.keyboard.press("-")
    assert np.count_nonzero(np.abs(picture(page) - focused).max(axis=2) > 30) < 0.01 * first[..., 0].size
    page.keyboard.press("ArrowLeft")
    assert np.count_nonzero(np.abs(picture(page) - focused).max(axis=2) > 30) > 0.02 * first[..., 0].size
    page.keyboard.press("0")
    assert np.count_nonzero(np.abs(picture(page) - focused).max(axis=2) > 30) < 0.01 * first[..., 0].size


def test_what_is_swapped_out_lets_go_and_what_is_swapped_in_is_drawn(open_page, address):
    page = opened(open_page, address)
    page.evaluate("window.former = document.querySelector('canvas')")
    page.evaluate("{ const here = document.getElementById('here'); here.replaceWith(here.cloneNode(false)); }")
    wait_until(page, "document.querySelector('canvas[data-frames]') !== window.former")
    page.wait_for_selector("canvas[data-frames]")
    assert page.evaluate("window.former.getContext('webgl2').isContextLost()")
    assert orange(page) > 3000


def test_without_webgl_or_a_scene_it_says_so_and_without_webgl_shows_picture_and_table(open_page, address):
    watched = open_page(address)
    watched.page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    watched.goto("/meal.html")
    watched.page.wait_for_selector(".meal3d img")
    wait_until(watched.page, "document.querySelector('.meal3d img').naturalWidth > 0")
    expect(watched.page.locator(".meal3d [role=status]")).to_contain_text("no WebGL")
    expect(watched.page.locator(".meal3d tbody tr")).to_have_count(1)
    expect(watched.page.locator("canvas")).to_have_count(0)
    watched.expect("404")
    watched.goto("/none.html")
    expect(watched.page.locator(".meal3d .notice")).to_have_text("There is no 3D view of this run.")
