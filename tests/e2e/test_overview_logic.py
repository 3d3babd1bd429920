"""What the overview's map and charts compute (static/map-view.js, map.js, charts.js), by itself."""

import pytest

from tests.e2e.static_modules import module_page


@pytest.fixture(scope="module")
def run(chromium):
    """What a script returns that may import the static modules."""
    with module_page(chromium) as page:
        yield lambda script: page.evaluate(f"async () => {{ {script} }}")


def test_view_turns_pixels_into_places_and_back(run):
    off = run("""
      const { MapView } = await import("/map-view.js");
      const view = new MapView([{ latitude: 60.2, longitude: 24.9 }, { latitude: 61.5, longitude: 23.8 }]);
      view.resize(700, 350);
      view.zoom(3, 100, 40);
      view.pan(33, -12);
      const found = [];
      for (const [longitude, latitude] of [[24.9, 60.2], [23.8, 61.5], [30, 50]]) {
        const place = view.placeOf(...view.pixelOf(longitude, latitude));
        found.push(Math.abs(place.longitude - longitude), Math.abs(place.latitude - latitude));
      }
      return Math.max(...found);
    """)
    assert off < 1e-9


def test_place_under_the_pointer_stays_when_the_map_is_zoomed(run):
    before, after = run("""
      const { MapView } = await import("/map-view.js");
      const view = new MapView([{ latitude: 1, longitude: 1 }, { latitude: 30, longitude: 40 }]);
      view.resize(600, 400);
      const before = view.placeOf(450, 90);
      view.zoom(2.5, 450, 90);
      return [before, view.placeOf(450, 90)];
    """)
    assert after == pytest.approx(before)


def test_scale_bar_is_as_long_as_it_says(run):
    # 0.1 degrees of latitude are 11.12 km
    for south in (0.0, 48.0, 70.0):
        bar, north = run(f"""
          const [south, north] = [{south}, {south} + 0.1];
          const {{ MapView }} = await import("/map-view.js");
          const view = new MapView([{{ latitude: south, longitude: 5 }}, {{ latitude: north, longitude: 5.1 }}]);
          view.resize(600, 400);
          return [view.scaleBar(), view.pixelOf(5, south)[1] - view.pixelOf(5, north)[1]];
        """)
        assert bar["pixels"] <= 120
        assert north / bar["pixels"] == pytest.approx(11.1195 / bar["km"], rel=1e-6)


def test_people_on_both_sides_of_the_180th_meridian_are_near(run):
    starts = run("""
      const { westernmost } = await import("/map-view.js");
      return [[178, -170.7, 179.9], [10, 20, 30], [-80, 100], [5], [-179, 179]].map(westernmost);
    """)
    assert starts == [178, 10, -80, 5, 179]


def test_stacked_bars_end_at_the_sum_of_those_below(run):
    tops = run("""
      globalThis.uPlot = {};
      const { stackedTops } = await import("/charts.js");
      return stackedTops([{ values: [1, 2] }, { values: [3, null] }, { values: [5, 7] }]);
    """)
    assert tops == [[1, 2], [4, 2], [9, 9]]


def test_land_is_whole_rings_within_the_globe(run):
    rings = run("""
      const { readLand } = await import("/map.js");
      const rings = readLand(await (await fetch("/vendor/natural-earth/land.json")).json());
      return rings.map((ring) => Array.from(ring));
    """)
    assert len(rings) > 100
    for ring in rings:
        assert all(-90 <= latitude <= 90 for latitude in ring[1::2])
        steps = [abs(east - west) for west, east in zip(ring[::2], ring[2::2], strict=False)]
        assert all(step < 60 for step in steps[:-1]), "no line across the map"
        assert steps[-1] in (pytest.approx(360, abs=0.1), pytest.approx(min(steps[-1], 59), abs=1e-9))
    singapore_s_neighbour = (102.0, 3.5)  # Malaysia
    assert sum(is_inside(ring, *singapore_s_neighbour) for ring in rings) % 2 == 1
    assert sum(is_inside(ring, -30.0, 30.0) for ring in rings) % 2 == 0, "the Atlantic"


def is_inside(ring, longitude, latitude):
    """By the even-odd rule, on any turn of the globe."""
    points = list(zip(ring[::2], ring[1::2], strict=True))
    return sum(crosses(points, longitude + turn, latitude) for turn in (-360, 0, 360)) % 2 == 1


def crosses(points, x, y):
    found = False
    for (x0, y0), (x1, y1) in zip(points, [*points[1:], points[0]], strict=True):
        if (y0 > y) != (y1 > y) and x < (x1 - x0) * (y - y0) / (y1 - y0) + x0:
            found = not found
    return found
