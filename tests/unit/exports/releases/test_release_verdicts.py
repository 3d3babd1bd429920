"""New names of a release's rows: all changes in their order, with one digest per name."""

import uuid
from datetime import UTC, datetime
from itertools import permutations

from app.exports.release_models import ReleaseChange
from app.exports.releases.alter_release import Verdicts, meal_digest, participant_digest
from app.people.access.secret_box import SecretBox

IDS = uuid.UUID(int=7)
MEAL = str(uuid.UUID(int=1))
NEW_MEAL = str(uuid.uuid5(IDS, MEAL))


BOX = SecretBox("a key for tests only, of no worth")


def change(deed, digest, **renamed):
    return ReleaseChange(
        id=uuid.uuid4(), release_id=IDS, deed=deed, digest=digest, requested_at=datetime.now(UTC), **renamed
    )


ANONYMISED = change("anonymise", participant_digest(BOX, "P001"), new_code="withdrawn-1", new_ids=IDS)
LATER_ERASED = change("erase", participant_digest(BOX, "withdrawn-1"))
LATER_MEAL = change("meal", meal_digest(BOX, "withdrawn-1", NEW_MEAL))


def test_change_of_a_new_code_applies_only_after_the_rename():
    assert Verdicts(BOX, [ANONYMISED, LATER_ERASED])("P001", MEAL) is None
    assert Verdicts(BOX, [LATER_ERASED, ANONYMISED])("P001", MEAL) == ("withdrawn-1", NEW_MEAL)
    assert Verdicts(BOX, [ANONYMISED, LATER_MEAL])("P001", MEAL) is None
    assert Verdicts(BOX, [ANONYMISED, LATER_MEAL])("P001") == ("withdrawn-1", None)


def test_rows_of_others_are_unchanged_and_erased_rows_are_gone_in_any_order():
    meal = change("meal", meal_digest(BOX, "P002", MEAL))
    person = change("erase", participant_digest(BOX, "P003"))
    for changes in permutations([meal, person, ANONYMISED]):
        judge = Verdicts(BOX, changes)
        assert judge("P002", MEAL) is judge("P003", MEAL) is judge("P003") is None
        assert (judge("P002"), judge("P004", MEAL)) == (("P002", None), ("P004", MEAL))
