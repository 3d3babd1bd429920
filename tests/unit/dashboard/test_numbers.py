"""Numbers on the pages: rounded for the eye, never to nothing, and never so long that they leave their column."""

import pytest
from markupsafe import Markup

from app.dashboard.templates import amount, environment, interval


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0"),
        (0.00012, "0.00012"),
        (0.0497, "0.050"),
        (0.894, "0.89"),
        (8.049, "8.05"),
        (80.49, "80.5"),
        (-1804.9, "−1 805"),
        (1e147, "1.00e+147"),
        (2_000_000_000, "2 000 000 000"),
    ],
)
def test_number_keeps_two_figures_and_is_never_long(value, shown):
    assert Markup(amount(value)).striptags() == shown


def test_each_end_of_an_interval_has_its_own_figures():
    assert interval((0.5, 15_000.4), "ml").striptags() == "0.50 to 15 000 ml"
    assert interval((None, 1.0)) == ""


def test_number_of_meals_that_is_no_longer_counted_is_not_shown_as_exact():
    pages = environment().get_template("parts.html").module
    assert [Markup(pages.to_look_at(meals)).striptags() for meals in (999, 1000)] == ["999", "1 000+"]
