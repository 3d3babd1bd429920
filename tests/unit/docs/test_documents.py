"""Documents that list what the code has: they may not drift."""

import pathlib

from app.settings import Settings

DOCS = pathlib.Path(__file__).parents[3] / "docs"


def test_every_setting_stands_in_the_documents_with_its_default_and_words():
    text = (DOCS / "settings.md").read_text()
    rows = [line for line in text.splitlines() if line.startswith("| `TADA_")]
    assert len(rows) == len(Settings.model_fields)
    for name, field in Settings.model_fields.items():
        default = "" if field.default is None else f"`{field.default}`"
        assert f"| `TADA_{name.upper()}` | {default} | {field.description} |" in rows
