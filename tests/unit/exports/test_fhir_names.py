"""Patients' ids and tokens: made and read back, whatever the codes."""

import contextlib
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.errors import MalformedRequestError
from app.exports.fhir.dates import narrowed
from app.exports.fhir.fhir_intakes import PersonName
from app.exports.fhir.names import Names, patient_id, person_of_id, person_of_token
from app.exports.fhir.queries import IntakeFilter

NAMES = Names("https://tada.example.org/fhir")
codes = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_-]{0,40}", fullmatch=True)


@given(codes, codes)
def test_an_id_is_one_of_fhir_and_names_its_participant_again(study, code):
    found = patient_id(study, code)
    if found is None:
        assert len(study) + len(code) + f"{study}{code}".count("_") + 1 > 64
    else:
        assert re.fullmatch(r"[A-Za-z0-9\-.]{1,64}", found)
        assert person_of_id(found) == PersonName(study, code)


@given(codes, codes)
def test_a_token_names_its_participant_again(study, code):
    assert person_of_token(NAMES, f"{NAMES.participants(study)}|{code}") == PersonName(study, code)
    assert person_of_token(NAMES, f"{study}|{code}") == PersonName(study, code)


@pytest.mark.parametrize("text", ["", ".", "..", "a.b.c", "-a", "a b", "a/b", "é", "x" * 200])
def test_what_no_participant_is_called_is_nobody(text):
    assert person_of_id(text) is None


@given(
    st.text(max_size=40) | st.from_regex(r"(eq|ge|le|gt|lt|sa|eb)?\d{4}(-\d\d)?(-\d\d)?(T[\d:.]{0,15}(Z|[+-][\d:]+)?)?")
)
def test_any_text_is_a_date_or_refused(text):
    with contextlib.suppress(MalformedRequestError):
        assert narrowed(IntakeFilter(), text) != IntakeFilter()
