"""No private names of other packages in the program, and the tool that looks for them."""

import subprocess
import sys

import pytest

from tests.e2e.processes import REPOSITORY
from tools.check_private_names import private_imports, silenced


@pytest.mark.parametrize(
    "line",
    [
        "from h11._readers import Reader",
        "from dbos import _core",
        "import numpy._core",
        "import _thread",
        "from x.y import _z",
    ],
)
def test_import_of_a_private_name_is_reported(line):
    assert len(list(private_imports(line))) == 1


@pytest.mark.parametrize(
    "line", ["from app.x import _y", "from . import _y", "from h11 import Connection", "import numpy as _np"]
)
def test_import_of_a_public_or_an_own_name_is_not(line):
    assert list(private_imports(line)) == []


def test_access_that_ruff_is_told_to_allow_is_reported():
    assert list(silenced("a = 1\nb = x._y  # noqa: SLF001  # why\n")) == [(2, "b = x._y  # noqa: SLF001  # why")]


def test_program_uses_none():
    done = subprocess.run(
        [sys.executable, "tools/check_private_names.py"], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "")
