"""The catalogues of sentences: complete in every language, of known codes only, and the language that is chosen."""

import re
import string
import tomllib
from pathlib import Path

import pytest

from app.diary.feedback import COMPARED, sum_amounts
from app.meals.stored.record_models import EffectiveRecord
from app.messages.catalogue import catalogue, choose_locale, feedback_sentence, photograph_codes, sentence
from app.nutrition.intakes.compare_intake import Verdict
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


@pytest.mark.parametrize("code", sorted(catalogue("feedback")))
def test_each_sentence_has_all_languages_with_the_same_values(code):
    sentences = catalogue("feedback")[code]
    assert set(sentences) == set(LOCALES)
    values = [{name.removesuffix("_kj") for name in placeholders(text)} for text in sentences.values()]
    assert values == values[:1] * len(LOCALES)
    for locale in LOCALES:
        told = feedback_sentence(code, locale, **dict.fromkeys(placeholders(sentences[locale]), "1"))
        assert told
        assert "{" not in told


def test_each_verdict_and_nutrient_has_a_sentence_and_a_language_without_falls_back():
    codes = set(catalogue("feedback"))
    assert set(Verdict.__args__) <= codes
    assert {f"name_{headline.column}" for headline in COMPARED} <= codes
    assert {f"unit_{headline.unit}" for headline in COMPARED} <= codes
    assert [choose_locale(None, None, name) for name in ("de", "fr", "")] == ["de", "en", "en"]


def record(grams, low, high, energy):
    return EffectiveRecord(consumed_g=grams, consumed_low_g=low, consumed_high_g=high, energy_kcal=energy)


def test_interval_of_a_sum_reaches_from_all_low_to_all_high_and_is_never_below_zero():
    found = sum_amounts([record(100.0, 80.0, 120.0, 50.0), record(200.0, 150.0, 300.0, 100.0)])["energy_kcal"]
    assert (found.amount, found.interval, found.coverage) == (150.0, (40.0 + 75.0, 60.0 + 150.0), 1.0)
    unknown = sum_amounts([record(100.0, None, None, 50.0), record(None, None, None, None)])["energy_kcal"]
    assert (unknown.amount, unknown.interval, unknown.coverage) == (50.0, None, None)
    assert sum_amounts([])["energy_kcal"].amount is None
    found = sum_amounts([record(-4.0, -10.0, 2.0, -2.0)])["energy_kcal"]
    assert (found.amount, found.interval) == (0.0, (0.0, 1.0))


def test_nothing_eaten_within_an_interval_of_grams_is_no_certain_nothing():
    """A summary said [0, 0] kcal where the meal itself said -30.6 to 30.6."""
    found = sum_amounts([record(0.0, -20.0, 20.0, 0.0)])["energy_kcal"]
    assert (found.amount, found.interval) == (0.0, None)
    certain = sum_amounts([record(0.0, 0.0, 0.0, 0.0)])["energy_kcal"]
    assert (certain.amount, certain.interval) == (0.0, (0.0, 0.0))
    by_the_table = sum_amounts([record(0.0, 0.0, 0.0, 0.0), record(100.0, 80.0, 120.0, 0.0)])["energy_kcal"]
    assert (by_the_table.amount, by_the_table.interval) == (0.0, None)
