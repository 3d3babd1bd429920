"""/docs/guide: docs/ as pages."""

import pytest

from app.dashboard.guide import PATH, guide_folder, guide_pages
from tests.integration.dashboard.conftest import text_of


def test_every_link_between_pages_leads_to_a_page_and_a_heading_or_a_file():
    pages = guide_pages()
    anchors = {name: {section.anchor for section in page.sections} | {""} for name, page in pages.items()}
    links = [(page.name, *link) for page in pages.values() for link in page.links]
    broken = [
        (name, target, anchor)
        for name, target, anchor in links
        if not (anchor in anchors[target] if target in pages else (guide_folder() / target).is_file())
    ]
    assert broken == []
    assert links


def test_every_page_is_served_to_anybody_under_a_policy_that_it_keeps(client):
    for name, page in guide_pages().items():
        answer = client.get(f"{PATH}/{name}")
        assert answer.status_code == 200, name
        assert page.title in text_of(answer.text).replace("&#39;", "'")
        assert "script-src 'self'" in answer.headers["content-security-policy"]
        assert " style=" not in answer.text, name
    assert client.get(f"{PATH}/pictures/capture.webp").headers["content-type"] == "image/webp"
    assert client.get(PATH, follow_redirects=True).status_code == 200


@pytest.mark.parametrize("path", ["nothing", "../README", "%2e%2e/README", ".hidden"])
def test_what_is_no_page_is_not_found(client, path):
    assert client.get(f"{PATH}/{path}").status_code == 404


def test_search_finds_the_section_with_all_words(client):
    found = client.get(f"{PATH}/", params={"q": "Retention photographs"}).text
    assert f'href="{PATH}/privacy#retention-of-photographs"' in found
    assert "No section has all of these words." in client.get(f"{PATH}/", params={"q": "<b>xylophone"}).text
    assert "<b>" not in client.get(f"{PATH}/", params={"q": "<b>xylophone"}).text
