"""A code to one sentence in the participant's language. `{where}` in a sentence is the photograph that it is about."""

import functools
import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import Literal, cast

from app.db.models.people import LOCALES, Locale

FALLBACK: Locale = "en"
ANY_PHOTO = "any"  # where the code alone is known: which of the two is not

Side = Literal["left", "right"]


@functools.cache
def _catalogue() -> Mapping[str, Mapping[str, str]]:
    text = resources.files(__package__).joinpath("sentences.toml").read_text(encoding="utf-8")
    return cast("Mapping[str, Mapping[str, str]]", tomllib.loads(text))


def known_codes() -> frozenset[str]:
    """The codes that have a sentence."""
    return frozenset(_catalogue()) - {f"where_{place}" for place in ("left", "right", ANY_PHOTO)}


def sentence(code: str, locale: Locale, side: Side | None = None) -> str | None:
    """The sentence of a code; None if there is none."""
    found = _catalogue().get(code)
    if found is None:
        return None
    where = _catalogue()[f"where_{side or ANY_PHOTO}"][locale]
    told = found[locale].format(where=where)
    return told[:1].upper() + told[1:]


def choose_locale(asked: str | None, accept_language: str | None, of_study: str) -> Locale:
    """The language to answer in: asked for, else the best of the header's that we have, else the study's.

    accept_language: RFC 9110, section 12.5.4; what cannot be read in it is passed over.
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
    return [tag for _, tag in sorted(weighed, key=lambda one: -one[0])]
