"""The tool that looks for private names of other packages; `make check` runs it over the program."""

import pytest

from tools.check_private_names import private_imports, silenced


@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("from h11._readers import Reader", 1),
        ("from dbos import _core", 1),
        ("import numpy._core", 1),
        ("import _thread", 1),
        ("from app.x import _y", 0),
        ("from . import _y", 0),
        ("from h11 import Connection", 0),
        ("import numpy as _np", 0),
    ],
)
def test_import_of_a_private_name_of_others_is_reported_and_access_that_ruff_is_told_to_allow(line, count):
    assert len(list(private_imports(line))) == count
    assert list(silenced("a = 1\nb = x._y  # noqa: SLF001  # why\n")) == [(2, "b = x._y  # noqa: SLF001  # why")]
