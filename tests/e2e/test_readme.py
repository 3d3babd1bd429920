"""The README's walk-through, run word for word against a server of its own."""

import pathlib
import re

import pytest

from tests.e2e.documents import BLOCK, run_blocks
from tests.e2e.processes import REPOSITORY, Server


def walk_through():
    text = (REPOSITORY / "README.md").read_text()
    start = text.index("<!-- walk-through")
    return BLOCK.findall(text[start : text.index("<!-- end of the walk-through -->")])


@pytest.mark.slow
def test_every_line_of_the_walk_through_works_as_printed(tmp_path):
    server = Server(tmp_path)
    server.place_prepared_database()
    server.start()
    try:
        server.wait_until_ready()
        blocks = walk_through()
        assert len(blocks) >= 4
        done = run_blocks(
            server, tmp_path, blocks, lambda text: text.replace("-o records.csv", f"-o {tmp_path}/records.csv")
        )
        assert done.returncode == 0, done.stderr + done.stdout + server.log
        assert '"status":"estimated"' in done.stdout
        assert '"status":"confirmed"' in done.stdout
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
