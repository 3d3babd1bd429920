"""Ids and tokens of Patients are read back for any codes; any text is a date or refused."""

import contextlib
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.errors import MalformedRequestError
from app.extras.fhir.dates import add_date
from app.extras.fhir.fhir_intakes import PersonName
from app.extras.fhir.names import Names, patient_id, person_of_id, person_of_token
from app.extras.fhir.queries import IntakeFilter

NAMES = Names("https://tada.example.org/fhir")
codes = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_-]{0,40}", fullmatch=True)


@given(codes, codes)
def test_patient_id_is_valid_in_fhir_and_it_and_tokens_are_read_back(study, code):
    logical_id = patient_id(study, code)
    if logical_id is None:
        assert len(study) + len(code) + f"{study}{code}".count("_") + 1 > 64
    else:
        assert re.fullmatch(r"[A-Za-z0-9\-.]{1,64}", logical_id)
        assert person_of_id(logical_id) == PersonName(study, code)
    assert person_of_token(NAMES, f"{NAMES.participants(study)}|{code}") == PersonName(study, code)
    assert person_of_token(NAMES, f"{study}|{code}") == PersonName(study, code)


@pytest.mark.parametrize("text", ["", ".", "..", "a.b.c", "-a", "a b", "a/b", "é", "x" * 200])
def test_invalid_id_names_no_participant(text):
    assert person_of_id(text) is None


@given(
    st.text(max_size=40) | st.from_regex(r"(eq|ge|le|gt|lt|sa|eb)?\d{4}(-\d\d)?(-\d\d)?(T[\d:.]{0,15}(Z|[+-][\d:]+)?)?")
)
def test_any_text_is_a_date_or_refused(text):
    with contextlib.suppress(MalformedRequestError):
        assert add_date(IntakeFilter(), text) != IntakeFilter()
