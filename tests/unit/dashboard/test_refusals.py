"""What pages say of values that cannot be: sentences for people, of the errors that pydantic really makes."""

from datetime import date, datetime
from typing import Annotated, Any, Literal

import pytest
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from app.dashboard.forms import checked
from app.dashboard.refusals import PATTERNS, sentence, sentence_of_request
from app.people.schemas import ParticipantIn, ParticipantPatch, StudyIn, StudyPatch
from app.releases.schemas import ReleaseIn


@pytest.mark.parametrize(
    ("of", "value", "told"),
    [
        (date, "yesterday", "Write a day as 2026-11-30."),
        (date, "2026-02-31", "Write a day as 2026-11-30."),
        (datetime, "noon", "Write a day and a time as 2026-11-30T12:30:00+01:00."),
        (Literal["needs_review", "rejected"], "banana", "There is no such choice; choose: needs review, rejected."),
        (Annotated[float, Field(gt=0)], "-5", "This must be more than 0."),
        (Annotated[float, Field(le=0.5)], "2", "This must be 0.5 or less."),
        (Annotated[int, Field(ge=-3)], "-4", "This must be -3 or more."),
        (int, "4.5", "Write a whole number, such as 4."),
        (float, "much", "Write a number, such as 4.6."),
        (Annotated[str, Field(min_length=1)], "", "This must not be empty."),
        (Annotated[str, Field(max_length=3)], "four", "This is too long: 3 characters at most."),
        (Annotated[list[str], Field(max_length=1)], ["a", "b"], "Choose 1 at most."),
        (Annotated[str, Field(pattern="^z$")], "a", "It contains a character that is not allowed here."),
    ],
    ids=str,
)
def test_error_is_told_as_what_to_write_instead(of, value, told):
    with pytest.raises(ValidationError) as refused:
        TypeAdapter(of).validate_python(value)
    (error,) = refused.value.errors()
    assert sentence(error["type"], error["msg"]) == told


@pytest.mark.parametrize("model", [ParticipantIn, ParticipantPatch, StudyIn, StudyPatch, ReleaseIn])
def test_every_pattern_of_a_form_has_words(model: type[BaseModel]):
    assert set(patterns_of(model.model_json_schema())) <= set(PATTERNS)


def patterns_of(schema: Any) -> list[str]:
    """All of a schema, wherever they stand."""
    if isinstance(schema, list):
        return [found for one in schema for found in patterns_of(one)]
    if not isinstance(schema, dict):
        return []
    own = [schema["pattern"]] if isinstance(schema.get("pattern"), str) else []
    return own + [found for one in schema.values() for found in patterns_of(one)]


def test_name_of_a_release_that_cannot_be_hears_what_can():
    body, wrong = checked(ReleaseIn, {"name": "First look!", "from": "soon"})
    assert body is None
    assert wrong["name"].startswith("Small letters a-z, digits, dot, _ and - only")
    assert wrong["from"] == "Write a day as 2026-11-30."


def test_part_of_a_field_is_named():
    _, wrong = checked(ParticipantPatch, {"profile": {"birth_year": "1700", "sex": "cat"}})
    assert "sex: There is no such choice; choose: female, male." in wrong["profile"]
    assert "birth year: This must be " in wrong["profile"]


def test_parameter_of_an_address_is_named_without_its_place():
    errors = [{"at": "query.status.0", "message": "Input should be 'a' or 'b'", "type": "literal_error"}]
    assert sentence_of_request(errors) == "Status: There is no such choice; choose: a, b."
    assert sentence_of_request([]) is None
