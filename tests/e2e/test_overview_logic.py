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
