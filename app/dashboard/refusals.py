"""What is wrong with a value, in a sentence for who typed it: pydantic's kind of error and message -> words of ours.

The API's problem documents keep pydantic's own messages, for programs and who writes them.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

A_DAY: Final = "Write a day as 2026-11-30."
A_MOMENT: Final = "Write a day and a time as 2026-11-30T12:30:00+01:00."
WHOLE: Final = "Write a whole number, such as 4."
A_NUMBER: Final = "Write a number, such as 4.6."

# By the pattern that a schema has; tests/unit/dashboard/test_refusals.py holds them against the forms' schemas.
PATTERNS: Final[Mapping[str, str]] = {
    r"^[A-Za-z0-9][A-Za-z0-9_-]*$": "Letters A-Z, digits, - and _ only, beginning with a letter or digit; no blanks.",
    r"^[a-z0-9][a-z0-9._-]{0,63}$": (
        "Small letters a-z, digits, dot, _ and - only, beginning with a letter or digit; no blanks, 64 characters at "
        "most."
    ),
    r"^(?:(?:0\d|1[01]):[0-5]\d|12:00)$": "Write a time from 00:00 to 12:00, as 03:00.",
}
_PLAIN: Final[Mapping[str, str]] = {
    "missing": "This field is required.",
    "extra_forbidden": "This field is not allowed here.",
    "bool_parsing": "Write true or false.",
    "uuid_parsing": "This is not an id.",
    "uuid_type": "This is not an id.",
    "string_type": "Write text.",
    "int_type": WHOLE,
    "int_parsing": WHOLE,
    "int_parsing_size": WHOLE,
    "int_from_float": WHOLE,
    "float_type": A_NUMBER,
    "float_parsing": A_NUMBER,
    "finite_number": A_NUMBER,
    "union_tag_invalid": "There is no such choice.",
    "union_tag_not_found": "There is no such choice.",
}
# {} is the number that pydantic's message names first
_LIMITS: Final[Mapping[str, str]] = {
    "greater_than": "This must be more than {}.",
    "greater_than_equal": "This must be {} or more.",
    "less_than": "This must be less than {}.",
    "less_than_equal": "This must be {} or less.",
    "string_too_short": "Letters or digits are missing: {} at least.",
    "string_too_long": "This is too long: {} characters at most.",
    "too_short": "Choose {} at least.",
    "too_long": "Choose {} at most.",
}
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_CHOICE = re.compile(r"'([^']*)'")
_PLACES = frozenset({"query", "path", "body", "header"})


def sentence(kind: str, message: str) -> str:
    """What to do instead, of one error: its type and its message, as pydantic tells them."""
    if kind in _PLAIN:
        return _PLAIN[kind]
    if kind in _LIMITS and (limit := _NUMBER.search(message)) is not None:
        return "This must not be empty." if _is_empty(kind, limit[0]) else _LIMITS[kind].format(limit[0])
    if kind.startswith("date_"):
        return A_DAY
    if kind.startswith("datetime_"):
        return A_MOMENT
    if kind in ("literal_error", "enum"):
        choices = [choice.replace("_", " ") for choice in _CHOICE.findall(message)]
        return f"There is no such choice; choose: {', '.join(choices)}."
    if kind == "string_pattern_mismatch":
        known = (words for pattern, words in PATTERNS.items() if f"'{pattern}'" in message)
        return next(known, "It contains a character that is not allowed here.")
    said = message.removeprefix("Value error, ").rstrip(".")
    return f"{said[:1].upper()}{said[1:]}."


def sentences(errors: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Pydantic's errors as field -> sentence; what is wrong inside of a field begins with the name of the part."""
    wrong: dict[str, list[str]] = {}
    for one in errors:
        field, *inner = one["loc"] or ("",)
        named = ", ".join(part_named(part) for part in inner if isinstance(part, str))
        told = sentence(one["type"], one["msg"])
        wrong.setdefault(str(field), []).append(f"{named}: {told}" if named else told)
    return {field: " ".join(dict.fromkeys(told)) for field, told in wrong.items()}


def sentence_of_request(errors: Sequence[Mapping[str, Any]]) -> str | None:
    """Of a problem document's `errors` (at, message, type) the first, under its parameter's name; None: there is none.

    "query.from" is a place of the API: a page calls it From.
    """
    if not errors:
        return None
    first = errors[0]
    parts = [part for part in str(first["at"]).split(".") if part not in _PLACES and not part.isdecimal()]
    told = sentence(str(first["type"]), str(first["message"]))
    name = part_named(parts[0]) if parts else ""
    return f"{name[:1].upper()}{name[1:]}: {told}" if name else told


def part_named(part: str) -> str:
    """A field of a body as it is read."""
    return part.replace("_", " ")


def _is_empty(kind: str, limit: str) -> bool:
    return kind == "string_too_short" and limit == "1"
