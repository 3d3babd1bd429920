"""The catalogue of sentences: complete in every language, of known codes only, and the language that is chosen."""

import re
import string
import tomllib
from pathlib import Path

import pytest

from app.messages.catalogue import choose_locale, photograph_codes, sentence
from app.people.models import LOCALES

ROOT = Path(__file__).parents[3]
CATALOGUE = tomllib.loads((ROOT / "app" / "messages" / "sentences.toml").read_text(encoding="utf-8"))


def placeholders(text):
    return sorted(name for _, name, _, _ in string.Formatter().parse(text) if name)


def codes_in(path, heading):
    text = (ROOT / "docs" / path).read_text()
    section = text.split(heading, 1)[1].split("\n## ", 1)[0]
    return set(re.findall(r"^\| `([a-z_]+)` \|", section, re.MULTILINE))


@pytest.mark.parametrize("code", sorted(CATALOGUE))
def test_code_has_all_languages_with_the_same_placeholders(code):
    told = CATALOGUE[code]
    assert set(told) == set(LOCALES)
    assert {tuple(placeholders(text)) for text in told.values()} in ({()}, {("where",)})
    for text in told.values():
        assert text == text.strip()
        assert text


def test_every_code_of_pairs_and_meals_has_a_sentence_and_every_sentence_is_of_a_code():
    wanted = codes_in("errors.md", "## Pairs that could be better") | codes_in("errors.md", "## Meals that cannot")
    missing = wanted - photograph_codes() - {"photograph_erased"}  # the privacy page's, told to nobody
    assert not missing
    listed = set(re.findall(r"^\| `([a-z_]+)` \|", (ROOT / "docs" / "errors.md").read_text(), re.MULTILINE))
    assert photograph_codes() <= listed
    assert sentence("no_such_code", "en") is None
    assert sentence("where_left", "en", "left") is not None  # a part of sentences, and not among the codes
    assert "where_left" not in photograph_codes()


@pytest.mark.parametrize("locale", LOCALES)
def test_sentence_is_one_names_the_photograph_and_begins_with_a_capital(locale):
    for code in photograph_codes():
        told = {side: sentence(code, locale, side) for side in (None, "left", "right")}
        assert "{" not in "".join(told.values())
        assert len(set(told.values())) == (3 if "where" in placeholders(CATALOGUE[code][locale]) else 1)
        for text in told.values():
            assert text[0] == text[0].upper()
            assert text[-1] in ".。"
            assert len(re.findall(r"[.。!?！？](\s|$)", text)) <= 1
            assert len(text) < 160


@pytest.mark.parametrize(
    ("asked", "header", "study", "chosen"),
    [
        (None, None, "de", "de"),
        (None, "fr", "de", "de"),
        (None, "es-MX,es;q=0.9,en;q=0.8", "de", "es"),
        (None, "en;q=0.2, zh-Hans-CN;q=0.7, fr", "de", "zh"),
        (None, "en;q=0", "de", "de"),
        (None, "*", "es", "es"),
        (None, ";;,=,q=1," * 1000, "zh", "zh"),
        ("zh", "es", "de", "zh"),
        (None, None, "tlh", "en"),
    ],
)
def test_locale_is_the_requested_one_else_the_headers_else_the_studys(asked, header, study, chosen):
    assert choose_locale(asked, header, study) == chosen
