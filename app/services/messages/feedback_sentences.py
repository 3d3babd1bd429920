"""The sentences of a participant's feedback, in the study's language: feedback.toml holds them."""

import functools
import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import cast

from app.db.models.people import LOCALES, Locale
from app.services.messages.catalogue import FALLBACK


@functools.cache
def feedback_catalogue() -> Mapping[str, Mapping[str, str]]:
    """Code -> language -> sentence."""
    text = resources.files(__package__).joinpath("feedback.toml").read_text(encoding="utf-8")
    return cast("Mapping[str, Mapping[str, str]]", tomllib.loads(text))


def feedback_sentence(code: str, locale: Locale, **values: object) -> str:
    """The sentence of a code with its values. Raises KeyError for a code that has none, or a value that is missing."""
    return feedback_catalogue()[code][locale].format(**values)


def locale_of(study_locale: str) -> Locale:
    """The study's language as one that there are sentences in."""
    return next((known for known in LOCALES if known == study_locale), FALLBACK)
