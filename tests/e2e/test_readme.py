"""The README's walk-through, run word for word against a server of its own."""

import pathlib
import re
import subprocess
import sys

import pytest

from tests.e2e.processes import REPOSITORY, Server

BLOCK = re.compile(r"```bash\n(.*?)```", re.DOTALL)


def walk_through():
    text = (REPOSITORY / "README.md").read_text()
    start = text.index("<!-- walk-through")
    return BLOCK.findall(text[start : text.index("<!-- end of the walk-through -->")])


@pytest.mark.slow
def test_every_line_of_the_walk_through_works_as_printed(tmp_path):
    server = Server(tmp_path)
    server.start()
    try:
        server.wait_until_ready()
        blocks = walk_through()
        assert len(blocks) >= 4
        script = "set -euo pipefail\n" + "\n".join(blocks)
        script = script.replace("http://127.0.0.1:8000", server.address).replace(
            "-o records.csv", f"-o {tmp_path}/records.csv"
        )
        script = script.replace(".venv/bin/tada", f"{sys.executable} -m app.cli")
        # what the README asks a reader to do by hand: ask again until the meal is estimated
        again = 'for _ in 1 2 3 4 5 6 7 8; do {} > m; grep -q \'"status":"estimated"\' m && break; done; cat m'
        script = re.sub(r'(curl [^\n]*wait=25"[^\n#]*)[^\n]*', lambda found: again.format(found[1]), script)
        for name in ("app", "tests"):
            (tmp_path / name).symlink_to(REPOSITORY / name)
        done = subprocess.run(
            ["bash", "-c", script],
            env=server.environment,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert done.returncode == 0, done.stderr + done.stdout + server.log
        assert '"status":"estimated"' in done.stdout
        rows = (tmp_path / "records.csv").read_text().splitlines()
        assert len(rows) >= 2
        assert "Apples" in rows[1] or "Apple" in rows[1]
    finally:
        server.stop()


def test_files_that_the_documents_link_to_exist():
    for page in [REPOSITORY / "README.md", *pathlib.Path(REPOSITORY / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", page.read_text()):
            if not target.startswith("http"):
                assert (page.parent / target).exists(), f"{page}: {target}"
