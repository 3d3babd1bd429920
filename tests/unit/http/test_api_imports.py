"""What a process that serves the API loads when it starts: its memory is mostly that (docs/limits.md)."""

import subprocess
import sys

import pytest

# Each is for the worker, the children that decode photographs, a command, or who asks for what needs it.
NOT_AT_START = ("cv2", "numpy", "scipy", "PIL", "pillow_heif", "pyarrow", "fpdf", "openpyxl", "alembic", "obstore")


@pytest.fixture(scope="module")
def loaded() -> frozenset[str]:
    """Names of the top-level packages in a fresh interpreter that has imported what `tada serve` imports."""
    code = "import sys, app.cli, app.cli.serving; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    return frozenset(name.partition(".")[0] for name in done.stdout.split())


def test_server_is_what_was_imported(loaded):
    assert {"uvicorn", "fastapi", "sqlalchemy", "app"} <= loaded


@pytest.mark.parametrize("package", NOT_AT_START)
def test_server_starts_without(package, loaded):
    assert package not in loaded
