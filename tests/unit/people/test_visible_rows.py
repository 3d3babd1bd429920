"""The rows that a caller may see."""

import uuid

from app.http.row_filter import RowFilter
from app.people.access.caller import DeviceCaller, StaffCaller, visible_rows

ANY_ID, PERSON, STUDY, OTHER = (uuid.UUID(int=n) for n in range(1, 5))


def test_phone_sees_its_participants_meals_and_staff_the_studies_in_which_their_role_suffices():
    # What another filter asks (flags) is looked up study by study: a phone's call must not read all of them.
    phone = DeviceCaller(device_id=ANY_ID, participant_id=PERSON, study_id=STUDY, participant_alias=ANY_ID)
    visible = visible_rows(phone, RowFilter(participant_id=ANY_ID, study_ids=frozenset({OTHER}), flags=("a",)))
    assert visible == RowFilter(participant_id=PERSON, study_ids=frozenset({STUDY}), flags=("a",))
    roles = {STUDY: "viewer", OTHER: "reviewer"}
    staff = StaffCaller(staff_id=ANY_ID, name="ann", is_admin=False, token_id=ANY_ID, roles=roles, needs="reviewer")
    assert visible_rows(staff, RowFilter()).study_ids == {OTHER}
