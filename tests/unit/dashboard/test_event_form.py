"""Forms of a meal's page that carry structure: outlines, forms by hand."""

import json
import uuid

import pytest

from app.core.errors import InvalidInputError
from app.dashboard.forms import WrongFieldError, number
from app.dashboard.meal_pages.event_form import EventForm, event_of

RINGS = [[[0.5, 0.0], [90.25, 0.0], [90.0, 90.0]], [[20.5, 20.5], [20.5, 60.0], [60.0, 60.0]]]
HAND = {"section": "prism", "x_mm": "80.5", "y_mm": "-12", "length_mm": "100", "width_mm": "60", "height_mm": "30"}


def read(kind, **fields):
    return event_of(EventForm(id=uuid.uuid4(), kind=kind, version=1, item=str(uuid.uuid4()), **fields))


def test_outline_is_read_by_lines_or_as_the_api_gives_it():
    assert read("redraw", polygon="1, 2\n3.5 4\n5;6").polygon == [(1.0, 2.0), (3.5, 4.0), (5.0, 6.0)]
    rings = read("redraw", polygon=json.dumps(RINGS)).polygon
    assert [[list(corner) for corner in ring] for ring in rings] == RINGS


@pytest.mark.parametrize("text", ["1, 2\nthree", "[[1, 2], [3", "[[1, 2], [3, 4]]", "[[NaN, 2], [3, 4], [5, 6]]"])
def test_outline_that_cannot_be_read_is_named(text):
    with pytest.raises(InvalidInputError, match="Outline"):
        read("redraw", polygon=text)


def test_numbers_of_a_form_by_hand_are_one_form():
    form = read("reshape", **HAND, yaw_deg="-30.5", lean_deg="", base_mm="4").form
    assert (form.section, form.centre_mm, form.length_mm, form.yaw_deg) == ("prism", (80.5, -12.0), 100.0, -30.5)
    assert (form.lean_deg, form.base_mm) == (0.0, 4.0)


def test_decimal_comma_is_read_where_it_cannot_mean_thousands():
    assert read("set_mass", mass_g="1,5").mass_g == 1.5
    assert [number(text) for text in ("1,5", "0,125", ",5", "1.5", "120,25")] == [1.5, 0.125, 0.5, 1.5, 120.25]
    with pytest.raises(WrongFieldError):
        number("1,500")
    with pytest.raises(InvalidInputError, match=r"^Grams: "):
        read("set_mass", mass_g="1,500")


@pytest.mark.parametrize(
    ("wrong", "label"), [({"width_mm": "-3"}, "Width"), ({"yaw_deg": ""}, "Turned by"), ({"x_mm": "nan"}, "Place")]
)
def test_wrong_number_of_a_form_is_named_by_its_label(wrong, label):
    with pytest.raises(InvalidInputError, match=f"^{label}: "):
        read("reshape", **(HAND | {"yaw_deg": "0"} | wrong))
