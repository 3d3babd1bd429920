"""The capture page's texts: the same in every language, and all that its scripts ask for."""

import json
import re
from typing import get_args

import pytest

from app.capture.files import STATIC
from app.meals.stored.models import MealStatus
from app.people.models import LOCATION_POLICIES, WITHDRAWAL_POLICIES

LANGUAGES = ("en", "de", "es", "zh")
SCRIPTS = [path for path in STATIC.rglob("*.js") if "vendor" not in path.parts]
BY_THEIR_VALUE = ("state_", "item_", "entry_", "advice_", "privacy_")  # the rest of these keys is a code
STATES_OF_THE_PHONE = {"draft", "waiting", "waiting_problem", "refused", "sent", "other_person"}


def texts_of(language):
    return json.loads((STATIC / "texts" / f"{language}.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("language", LANGUAGES[1:])
def test_language_has_the_keys_and_the_placeholders_of_the_english_texts(language):
    english, other = texts_of("en"), texts_of(language)
    assert list(other) == list(english)
    for key, text in english.items():
        assert sorted(re.findall(r"\{\w+\}", other[key])) == sorted(re.findall(r"\{\w+\}", text)), key
        assert other[key].strip()


def test_scripts_ask_for_all_texts_and_for_no_others():
    source = "\n".join(path.read_text(encoding="utf-8") for path in SCRIPTS)
    asked = set(re.findall(r"""\bt\("([a-z_]+)\"""", source))
    asked |= {key for pair in re.findall(r"""\bt\([^()"]*\? "([a-z_]+)" : "([a-z_]+)"\)""", source) for key in pair}
    asked |= set(re.findall(r"""\b(?:unauthenticated|withdrawn): "([a-z_]+)\"""", source))
    fixed = {key for key in texts_of("en") if not key.startswith(BY_THEIR_VALUE)}
    assert {key for key in asked if not key.startswith(BY_THEIR_VALUE)} == fixed


def test_every_state_of_a_meal_every_policy_and_every_piece_of_advice_has_a_text():
    policies = {f"place_{policy}" for policy in LOCATION_POLICIES}
    policies |= {f"leave_{policy}" for policy in WITHDRAWAL_POLICIES}
    privacy = {key.removeprefix("privacy_") for key in texts_of("en") if key.startswith("privacy_")}
    assert privacy == policies | {"photographs_kept", "photographs_deleted"}
    states = {key.removeprefix("state_") for key in texts_of("en") if key.startswith("state_")}
    assert states == set(get_args(MealStatus)) | STATES_OF_THE_PHONE
    listed = re.search(r"CODES = \[(.*?)\]", (STATIC / "live" / "advice.js").read_text(), re.DOTALL)[1]
    assert {f"advice_{code}" for code in re.findall(r'"([a-z_]+)"', listed)} == {
        key for key in texts_of("en") if key.startswith("advice_")
    }
