"""Validation errors on pages: sentences for people, from the errors that pydantic raises."""

from datetime import date, datetime
from typing import Annotated, Literal

import pytest
from pydantic import Field, TypeAdapter, ValidationError

from app.core.errors import ConflictError
from app.dashboard.forms import Model, WrongFormError, read_form, refused, sentence, sentence_of_request
from app.exports.releases.schemas import ReleaseIn
from app.people.schemas import ParticipantPatch


@pytest.mark.parametrize(
    ("annotation", "value", "expected"),
    [
        (date, "yesterday", "Write a day as 2026-11-30."),
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
def test_error_becomes_a_sentence_about_what_to_enter(annotation, value, expected):
    with pytest.raises(ValidationError) as refused:
        TypeAdapter(annotation).validate_python(value)
    (error,) = refused.value.errors()
    assert sentence(error["type"], error["msg"]) == expected


def refusals(model: type[Model], values: dict[str, object]) -> dict[str, str]:
    with pytest.raises(WrongFormError) as error:
        read_form(model, values)
    return error.value.wrong


def test_wrong_name_of_a_release_says_which_characters_are_allowed_and_a_part_of_a_field_is_named():
    wrong = refusals(ReleaseIn, {"name": "First look!", "from": "soon"})
    assert wrong["name"].startswith("Small letters a-z, digits, dot, _ and - only")
    assert wrong["from"] == "Write a day as 2026-11-30."
    wrong = refusals(ParticipantPatch, {"profile": {"birth_year": "1700", "sex": "cat"}})
    assert "sex: There is no such choice; choose: female, male." in wrong["profile"]
    assert "birth year: This must be " in wrong["profile"]


def test_parameter_or_field_that_cannot_be_read_is_named_and_an_empty_one_keeps_its_default():
    errors = [{"at": "query.status.0", "message": "Input should be 'a' or 'b'", "type": "literal_error"}]
    assert sentence_of_request(errors) == "Status: There is no such choice; choose: a, b."
    assert sentence_of_request([]) is None
    assert read_form(ReleaseIn, {"name": "first", "from": ""}) == ReleaseIn(name="first")
    with pytest.raises(WrongFormError) as error:
        read_form(ReleaseIn, {"name": "first"}, {"note": "This cannot be read."})
    assert error.value.wrong == {"note": "This cannot be read."}
    assert refused(ConflictError("It exists."), name="name").wrong == {"name": "It exists."}
