import pytest

from app.vision.hand_form import hand_form_ml


@pytest.mark.parametrize(("section", "volume_ml"), [("slab", 180.0), ("prism", 141.371669), ("ellipsoid", 94.247780)])
def test_volumes_are_those_of_box_elliptic_prism_and_ellipsoid(section, volume_ml):
    assert hand_form_ml(section, 100.0, 60.0, 30.0) == pytest.approx(volume_ml, rel=1e-7)
    assert hand_form_ml(section, 200.0, 120.0, 60.0) == pytest.approx(8 * volume_ml, rel=1e-7)
