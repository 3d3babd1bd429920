"""How a reader comes through the documents: a short README, one page for each kind of reader, and nothing left out."""

import re

import pytest

from app.records.meal_schemas import HintIn, NewMealMetadataIn
from tests.unit.docs.test_documents import DOCS

README = DOCS.parent / "README.md"
LINK = re.compile(r"\]\(([^)#\s]+\.md)(?:#[^)]*)?\)")


def linked_from(page):
    return {(page.parent / target).resolve() for target in LINK.findall(page.read_text()) if "://" not in target}


def test_readme_is_short_leads_each_reader_to_one_page_and_reaches_all():
    text = README.read_text()
    assert len(text.splitlines()) < 120
    readers = re.findall(r"^\| [^|]+ \| \[(docs/\w+\.md)\]\(\1\) \|$", text, re.MULTILINE)
    assert readers == ["docs/apps.md", "docs/research.md", "docs/operations.md", "docs/development.md"]
    seen, ahead = set(), [README.resolve()]
    while ahead:
        page = ahead.pop()
        if page not in seen:
            seen.add(page)
            ahead += linked_from(page)
    pages = {page.resolve() for page in DOCS.glob("*.md")}
    assert pages <= seen, sorted(page.name for page in pages - seen)


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


def test_commands_show_the_answer_of_a_refused_call():
    """curl -f hides the problem document, which says what is wrong."""
    for page in [README, *DOCS.glob("*.md")]:
        for line in page.read_text().splitlines():
            assert not re.search(r"\bcurl (?:\S+ )*?-\w*f\w*S", line), f"{page.name}: {line}"
