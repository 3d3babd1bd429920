"""Grams and nutrients of a helping: what the records' columns are."""

from app.foods.food_amounts import RECORD_COLUMNS
from app.meals.stored.record_models import HEADLINE_COLUMNS


def test_columns_of_records_are_those_of_the_table():
    assert tuple(RECORD_COLUMNS) == HEADLINE_COLUMNS
