import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.units import (
    Unit,
    UnitMismatchError,
    content_of_mass,
    convert,
    density_from_portion,
    kj_from_kcal,
    ml_from_mm3,
)


@pytest.mark.parametrize(
    ("value", "source", "target", "expected"),
    [
        (1.0, Unit.CUBIC_INCH, Unit.ML, 16.387064),
        (1.0, Unit.CUP, Unit.ML, 236.5882365),
        (1.0, Unit.FLUID_OUNCE, Unit.ML, 29.5735295625),
        (1.0, Unit.TEASPOON, Unit.ML, 4.92892159375),
        (0.5, Unit.G, Unit.UG, 500_000.0),
    ],
)
def test_published_sizes_of_units_are_met(value, source, target, expected):
    assert convert(value, source, target) == pytest.approx(expected, rel=1e-12)


def test_named_conversions_agree_with_their_definitions():
    assert ml_from_mm3(1000.0) == pytest.approx(1.0)
    assert kj_from_kcal(1.0) == pytest.approx(4.184)
    assert content_of_mass(52.0, 250.0) == pytest.approx(130.0)
    assert density_from_portion(244.0, 1.0, Unit.CUP) == pytest.approx(1.0313, abs=5e-5)  # of milk
    with pytest.raises(UnitMismatchError):
        density_from_portion(10.0, 1.0, Unit.G)


@given(st.floats(1e-6, 1e9), st.sampled_from(Unit), st.sampled_from(Unit))
def test_there_and_back_is_the_identity_and_across_quantities_is_refused(value, source, target):
    try:
        there = convert(value, source, target)
    except UnitMismatchError:
        with pytest.raises(UnitMismatchError):
            convert(value, target, source)
        return
    assert convert(there, target, source) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(("mass_g", "measure"), [(0.0, 1.0), (-1.0, 1.0), (1.0, 0.0), (float("nan"), 1.0)])
def test_portion_without_mass_or_volume_is_refused(mass_g, measure):
    with pytest.raises(ValueError, match="positive mass and volume"):
        density_from_portion(mass_g, measure, Unit.CUP)
