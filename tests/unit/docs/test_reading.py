"""How a reader comes through the documents: a short README, one page for each kind of reader, and nothing left out."""

import re

import pytest

from app.records.meal_schemas import HintIn, NewMealMetadataIn
from tests.unit.docs.test_documents import DOCS

README = DOCS.parent / "README.md"
LINK = re.compile(r"\]\(([^)#\s]+\.md)(?:#[^)]*)?\)")


def linked_from(page):
    return {(page.parent / target).resolve() for target in LINK.findall(page.read_text()) if "://" not in target}


def test_readme_is_short_and_leads_each_reader_to_one_page():
    text = README.read_text()
    assert len(text.splitlines()) < 120
    readers = re.findall(r"^\| [^|]+ \| \[(docs/\w+\.md)\]\(\1\) \|$", text, re.MULTILINE)
    assert readers == ["docs/apps.md", "docs/research.md", "docs/operations.md", "docs/development.md"]


def test_every_page_is_reached_from_the_readme():
    seen, ahead = set(), [README.resolve()]
    while ahead:
        page = ahead.pop()
        if page not in seen:
            seen.add(page)
            ahead += linked_from(page)
    pages = {page.resolve() for page in DOCS.glob("*.md")}
    assert pages <= seen, sorted(page.name for page in pages - seen)


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
