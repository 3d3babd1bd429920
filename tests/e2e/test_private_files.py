"""What the program writes is for its user alone, whatever the shell's umask says."""

import os
import stat
import subprocess
import sys

import pytest


@pytest.mark.slow
def test_files_of_a_new_deployment_are_readable_by_nobody_else(tmp_path):
    """With umask 022 the SQLite file, which holds names and tokens, was readable by every local user."""
    data = tmp_path / "data"
    variables = {name: value for name, value in os.environ.items() if not name.startswith("TADA_")}
    made = subprocess.run(
        [sys.executable, "-m", "app.cli", "admin", "create", "boss"],
        env=variables | {"TADA_DATA_DIR": str(data)},
        umask=0o022,
        check=True,
        capture_output=True,
        text=True,
    )
    assert made.stdout.strip()
    written = [data, *data.rglob("*")]
    assert any(path.name.startswith("tada.sqlite3") for path in written)
    assert {path.name: oct(stat.S_IMODE(path.stat().st_mode)) for path in written if path.stat().st_mode & 0o077} == {}
