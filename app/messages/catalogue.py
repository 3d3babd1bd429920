"""Sentences for participants in their language: about photographs (sentences.toml), of the feedback (feedback.toml).

`{where}` in a sentence of sentences.toml names the photograph; those of feedback.toml take the values of their figures.
"""

import functools
import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import Literal, cast

from app.people.models import LOCALES, Locale

FALLBACK: Locale = "en"
ANY_PHOTO = "any"  # where the code alone is known: which of the two is not

Side = Literal["left", "right"]


@functools.cache
def catalogue(name: Literal["sentences", "feedback"]) -> Mapping[str, Mapping[str, str]]:
    """Code -> language -> sentence."""
    text = resources.files(__package__).joinpath(f"{name}.toml").read_text(encoding="utf-8")
    return cast("Mapping[str, Mapping[str, str]]", tomllib.loads(text))


def known_codes() -> frozenset[str]:
    """The codes that have a sentence about photographs."""
    return frozenset(catalogue("sentences")) - {f"where_{place}" for place in ("left", "right", ANY_PHOTO)}


def feedback_sentence(code: str, locale: Locale, **values: object) -> str:
    """The feedback's sentence of a code. Raises KeyError for an unknown code or a missing value."""
    return catalogue("feedback")[code][locale].format(**values)


def sentence(code: str, locale: Locale, side: Side | None = None) -> str | None:
    """The sentence about a photograph of a code; None if the code has none."""
    sentences = catalogue("sentences")
    if code not in sentences:
        return None
    text = sentences[code][locale].format(where=sentences[f"where_{side or ANY_PHOTO}"][locale])
    return text[:1].upper() + text[1:]


def choose_locale(asked: str | None, accept_language: str | None, of_study: str) -> Locale:
    """Return the language that is asked for, else the header's best that there is, else the study's.

    accept_language: RFC 9110, section 12.5.4; its malformed parts are skipped.
    """
    for wanted in (asked, *_by_preference(accept_language or ""), of_study):
        primary = (wanted or "").strip().lower().replace("_", "-").partition("-")[0]
        for locale in LOCALES:
            if locale == primary:
                return locale
    return FALLBACK


def _by_preference(accept_language: str) -> list[str]:
    weighed: list[tuple[float, str]] = []
    for part in accept_language[:500].split(","):
        tag, _, parameter = part.partition(";")
        name, _, value = parameter.strip().partition("=")
        try:
            weight = float(value) if name == "q" else 1.0
        except ValueError:
            continue
        if weight > 0.0:
            weighed.append((weight, tag))
    return [tag for _, tag in sorted(weighed, key=lambda pair: -pair[0])]
