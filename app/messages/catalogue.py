"""Sentences for participants in their language: about photographs (sentences.toml), of feedback, and on cards.

`{where}` in sentences.toml names the photograph; placeholders in feedback.toml are values of the feedback.
"""

import functools
import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import Literal, cast

from app.people.models import LOCALES, Locale

FALLBACK: Locale = "en"
ANY_PHOTO = "any"  # if it is unknown which of the two photographs is meant

Side = Literal["left", "right"]


@functools.cache
def catalogue(name: Literal["sentences", "feedback", "cards"]) -> Mapping[str, Mapping[str, str]]:
    """Return the sentences by code and language."""
    text = resources.files(__package__).joinpath(f"{name}.toml").read_text(encoding="utf-8")
    return cast("Mapping[str, Mapping[str, str]]", tomllib.loads(text))


def photograph_codes() -> frozenset[str]:
    """Return the codes that have a sentence about photographs."""
    return frozenset(catalogue("sentences")) - {
        f"where_{place}" for place in ("left", "right", ANY_PHOTO)
    }


def feedback_sentence(code: str, locale: Locale, **values: object) -> str:
    """Return the feedback's sentence of a code. Raises KeyError for an unknown code or a missing value."""
    return catalogue("feedback")[code][locale].format(**values)


def sentence(code: str, locale: Locale, side: Side | None = None) -> str | None:
    """Return the sentence of a code about a photograph; None if the code has none."""
    sentences = catalogue("sentences")
    if code not in sentences:
        return None
    text = sentences[code][locale].format(where=sentences[f"where_{side or ANY_PHOTO}"][locale])
    return text[:1].upper() + text[1:]


def choose_locale(requested: str | None, accept_language: str | None, study_locale: str) -> Locale:
    """Return the requested language if it is supported, else the header's best supported one, else the study's.

    accept_language: RFC 9110, section 12.5.4; malformed parts are skipped.
    """
    for language in (requested, *_by_preference(accept_language or ""), study_locale):
        primary = (language or "").strip().lower().replace("_", "-").partition("-")[0]
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
