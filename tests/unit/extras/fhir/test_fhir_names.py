"""Ids and tokens of Patients are read back for any codes, and the meals that a caller may see."""

import contextlib
import re
import uuid

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.errors import MalformedRequestError
from app.extras.fhir.dates import add_date
from app.extras.fhir.fhir_intakes import PersonName
from app.extras.fhir.names import Names, patient_id, person_of_id, person_of_token
from app.extras.fhir.queries import IntakeFilter
from app.http.row_filter import RowFilter
from app.people.access.caller import DeviceCaller, StaffCaller, visible_rows

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


ANY_ID, PERSON, STUDY, OTHER = (uuid.UUID(int=n) for n in range(1, 5))


def test_phone_sees_its_participants_meals_and_staff_the_studies_in_which_their_role_suffices():
    # What another filter asks (flags) is looked up study by study: a phone's call must not read all of them.
    phone = DeviceCaller(device_id=ANY_ID, participant_id=PERSON, study_id=STUDY, participant_alias=ANY_ID)
    visible = visible_rows(phone, RowFilter(participant_id=ANY_ID, study_ids=frozenset({OTHER}), flags=("a",)))
    assert visible == RowFilter(participant_id=PERSON, study_ids=frozenset({STUDY}), flags=("a",))
    roles = {STUDY: "viewer", OTHER: "reviewer"}
    staff = StaffCaller(staff_id=ANY_ID, name="ann", is_admin=False, token_id=ANY_ID, roles=roles, needs="reviewer")
    assert visible_rows(staff, RowFilter()).study_ids == {OTHER}
