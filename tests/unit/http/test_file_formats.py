"""The formats of tables."""

from typing import get_args

from app.http.file_formats import FORMATS, Output


def test_each_format_that_can_be_asked_for_is_known():
    assert tuple(FORMATS) == get_args(Output)
