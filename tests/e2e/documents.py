"""The shell blocks of a document, run as one script against a server of the test's own."""

import re
import subprocess
import sys

from tests.e2e.processes import REPOSITORY

BLOCK = re.compile(r"```bash\n(.*?)```", re.DOTALL)


def run_blocks(server, folder, blocks, change=lambda script: script):
    """Run the blocks in a folder that looks like the checkout to them; change: what a reader would do by hand."""
    script = "set -euo pipefail\n" + "\n".join(blocks)
    script = script.replace("http://127.0.0.1:8000", server.address)
    script = script.replace(".venv/bin/tada", f"{sys.executable} -m app.cli")
    for name in ("app", "tests"):
        (folder / name).symlink_to(REPOSITORY / name)
    return subprocess.run(
        ["bash", "-c", change(script)],
        env=server.environment,
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
