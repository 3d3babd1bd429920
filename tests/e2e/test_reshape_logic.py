"""The numbers of a form by hand in the browser (static/reshape-form.js) against Python's and OpenCV's."""

import itertools

import cv2
import numpy as np
import pytest

from app.vision.hand_form import BOX_SHARE, hand_form_ml
from tests.e2e.static_modules import module_page

FORM = {
    "section": "slab",
    "centre_mm": [60.0, -25.0],
    "length_mm": 90.0,
    "width_mm": 50.0,
    "height_mm": 40.0,
    "yaw_deg": 33.0,
    "lean_deg": 12.0,
    "base_mm": 6.0,
}
ROTATION = cv2.Rodrigues(np.array([2.3, 0.2, -0.3]))[0]
CAMERA = {
    "fx": 1400.0,
    "fy": 1390.0,
    "cx": 620.0,
    "cy": 470.0,
    "distortion": [0.08, -0.15, 0.001, -0.002, 0.05],
    "rotation": ROTATION.tolist(),
    "translation_mm": [-20.0, 15.0, 480.0],
}


@pytest.fixture(scope="module")
def run(chromium):
    """What a script returns that has the module as `shape`, FORM and CAMERA."""

    def evaluate(script, argument=None):
        body = f'async ([FORM, CAMERA, argument]) => {{ const shape = await import("/reshape-form.js"); {script} }}'
        return page.evaluate(body, [FORM, CAMERA, argument])

    with module_page(chromium) as page:
        yield evaluate


def test_volumes_are_those_that_the_server_computes(run):
    sizes = list(itertools.product(BOX_SHARE, (2.0, 61.3, 1000.0), (2.0, 47.9), (3.1, 250.0)))
    forms = [
        {**FORM, "section": section, "length_mm": length, "width_mm": width, "height_mm": height}
        for section, length, width, height in sizes
    ]
    in_browser = run("return argument.map(shape.volumeMl);", forms)
    assert in_browser == pytest.approx([hand_form_ml(*size) for size in sizes], rel=1e-12)


def test_places_are_projected_as_opencv_does_and_rays_lead_back(run):
    places = np.random.default_rng(5).uniform([-90, -90, 0], [90, 90, 80], (40, 3))
    expected, _ = cv2.projectPoints(
        places,
        cv2.Rodrigues(ROTATION)[0],
        np.array(CAMERA["translation_mm"]),
        np.array([[CAMERA["fx"], 0, CAMERA["cx"]], [0, CAMERA["fy"], CAMERA["cy"]], [0, 0, 1]]),
        np.array(CAMERA["distortion"]),
    )
    pixels = run("return argument.map((place) => shape.project(CAMERA, place));", places.tolist())
    assert np.array(pixels) == pytest.approx(expected.reshape(-1, 2), abs=1e-6)
    script = (
        "return argument.map((place) => shape.onLevel(shape.rayOf(CAMERA, shape.project(CAMERA, place)), place[2]));"
    )
    assert np.array(run(script, places.tolist())) == pytest.approx(places[:, :2], abs=1e-4)
    assert run("return shape.project(CAMERA, argument);", (-10 * ROTATION.T[:, 2] * 480).tolist()) is None


def test_handle_dragged_to_where_another_form_has_it_gives_that_form(run):
    changes = {
        "length_mm": {"length_mm": 130.0},
        "width_mm": {"width_mm": 31.0},
        "height_mm": {"height_mm": 75.0},
        "lean_deg": {"lean_deg": -20.0},
        "yaw_deg": {"yaw_deg": -71.0},
        "move": {"centre_mm": [20.0, 44.0]},
    }
    script = """
      return Object.entries(argument).map(([name, change]) => {
        const handle = shape.HANDLES[name];
        const there = shape.project(CAMERA, handle.at({ ...FORM, ...change }));
        return [name, handle.dragged(FORM, shape.rayOf(CAMERA, there))];
      });
    """
    for name, form in run(script, changes):
        centre = form.pop("centre_mm")
        wanted = FORM | changes[name]
        assert centre == pytest.approx(wanted.pop("centre_mm"), abs=1e-3)
        assert form.pop("section") == wanted.pop("section")
        assert form == pytest.approx(wanted, abs=1e-3)


def test_dragged_sizes_and_lean_stay_within_what_the_server_takes(run):
    script = """
      const far = (name, x, y) => shape.HANDLES[name].dragged(FORM, shape.rayOf(CAMERA, [x, y]));
      const out = [];
      for (const name of ["length_mm", "width_mm", "height_mm", "lean_deg"])
        for (const x of [-5000, 0, 620, 5000])
          for (const y of [-5000, 470, 5000]) out.push([name, far(name, x, y)?.[name]]);
      return out;
    """
    for name, value in run(script):
        least, most = (-60, 60) if name == "lean_deg" else (2, 1000)
        assert value is None or least <= value <= most


def test_form_around_a_turned_box_is_the_box_and_its_section_the_one_of_its_volume(run):
    script = """
      const corners = shape.linesOf({ ...FORM, lean_deg: 0 }).flat();
      const form = shape.formAround(corners, FORM.base_mm);
      return [form, [1, Math.PI / 4, Math.PI / 6].map((share) => shape.nearestSection(form, 1.02 * share * 180))];
    """
    form, sections = run(script)
    assert form.pop("centre_mm") == pytest.approx(FORM["centre_mm"])
    assert form.pop("section") == "ellipsoid"
    wanted = {name: value for name, value in FORM.items() if name not in ("centre_mm", "section")} | {"lean_deg": 0}
    assert form == pytest.approx(wanted)
    assert sections == ["slab", "prism", "ellipsoid"]


@pytest.mark.parametrize("section", BOX_SHARE)
def test_lines_lie_on_the_form_and_reach_its_sides(run, section):
    places = np.array(
        run("return shape.linesOf({ ...FORM, section: argument, yaw_deg: 0, lean_deg: 0 }).flat();", section)
    )
    half = np.array([FORM["length_mm"], FORM["width_mm"], FORM["height_mm"]]) / 2
    middle = np.array([*FORM["centre_mm"], FORM["base_mm"] + half[2]])
    x, y, z = ((places - middle) / half).T
    assert [abs(each).max() for each in (x, y, z)] == pytest.approx([1, 1, 1], abs=1e-9)
    on_it = {"slab": np.maximum(abs(x), abs(y)), "prism": np.hypot(x, y), "ellipsoid": np.sqrt(x**2 + y**2 + z**2)}
    assert on_it[section] == pytest.approx(np.ones(len(places)))
