"""Which forms an event `reshape` may have."""

import pytest
from pydantic import TypeAdapter, ValidationError

from app.records.review.schemas import EventIn

EVENT = TypeAdapter(EventIn)
ITEM = "41aedb34-b4e0-4fb3-82ca-8bbb927a9914"
FORM = {"section": "slab", "centre_mm": [0, 0], "length_mm": 50, "width_mm": 40, "height_mm": 30, "yaw_deg": 0}
NOT_NUMBERS = (float("nan"), float("inf"), float("-inf"), 1e300, "much", None)


def read(**fields):
    return EVENT.validate_python({"id": ITEM, "kind": "reshape", "item": ITEM, "form": FORM | fields}).form


def test_form_stands_upright_on_the_table_unless_it_says_otherwise():
    form = read()
    assert (form.lean_deg, form.base_mm, form.centre_mm) == (0.0, 0.0, (0.0, 0.0))


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [
        ("length_mm", 2, 1000),
        ("width_mm", 2, 1000),
        ("height_mm", 2, 1000),
        ("yaw_deg", -360, 360),
        ("lean_deg", -60, 60),
        ("base_mm", -100, 500),
    ],
)
def test_each_number_has_its_range(name, least, most):
    assert [getattr(read(**{name: value}), name) for value in (least, most)] == [least, most]
    for value in (least - 0.1, most + 0.1, *NOT_NUMBERS):
        with pytest.raises(ValidationError):
            read(**{name: value})


@pytest.mark.parametrize("wrong", [{"section": "ball"}, {"centre_mm": [0]}, {"centre_mm": [0, 5001]}, {"volume_ml": 5}])
def test_other_form_is_refused(wrong):
    with pytest.raises(ValidationError):
        read(**wrong)
