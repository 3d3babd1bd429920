"""How a reader comes through the documents: a short README, one page for each kind of reader, and nothing left out."""

import re

import pytest

from app.records.meal_schemas import HintIn, NewMealMetadataIn
from tests.unit.docs.test_documents import DOCS

README = DOCS.parent / "README.md"


def anchors_of(page):
    """The anchors that GitHub gives a page's headings."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        for heading in re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    }


def test_every_anchor_is_a_heading_of_its_page():
    for page in [README, DOCS.parent / "CHANGELOG.md", *DOCS.rglob("*.md")]:
        for target, anchor in re.findall(r"\]\(([^)#\s]*)#([^)\s]+)\)", page.read_text()):
            if "://" not in target:
                assert anchor in anchors_of((page.parent / target) if target else page), (
                    f"{page.name}: {target}#{anchor}"
                )


@pytest.mark.parametrize(
    ("model", "heading"), [(NewMealMetadataIn, "| field | needed |"), (HintIn, "| field | meaning |")]
)
def test_page_for_apps_has_every_field_that_a_phone_may_send(model, heading):
    text = (DOCS / "apps.md").read_text()
    table = text[text.index(heading) :].split("\n\n")[0]
    named = re.findall(r"^\| `(\w+)`", table, re.MULTILINE)
    assert sorted(named) == sorted(model.model_fields)
