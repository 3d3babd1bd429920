"""What a process that serves the API loads when it starts: its memory is mostly that (docs/limits.md)."""

import subprocess
import sys

import pytest

# Each is for the worker, the children that decode photographs, a command, or who asks for what needs it.
NOT_AT_START = ("cv2", "numpy", "scipy", "PIL", "pillow_heif", "pyarrow", "fpdf", "openpyxl", "alembic", "obstore")


@pytest.mark.slow
def test_server_starts_without_what_others_need():
    code = "import sys, app.cli, app.cli.serving; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert {"uvicorn", "fastapi", "sqlalchemy", "app"} <= loaded
    assert loaded.isdisjoint(NOT_AT_START)
