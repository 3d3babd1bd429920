"""The filter that lists and files of records, meals, photographs and days have in common, and its parameters."""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import date
from typing import Literal


@dataclass(frozen=True, slots=True)
class RowFilter:
    """Which records (items), meals or days. None, or an empty tuple, leaves a filter out.

    first_day, last_day: local days, both included. statuses: of the item or the meal, by what a row
    is. Of a filter with several values any will do. food_keys, flags: of a record that holds (not
    rejected). needs: "review", the meal has a record that needs a look (records/page_queries.py),
    as the review queue has it; "answer", a question to the participant is open. participant_id,
    study_ids: what the caller may see.
    """

    study_code: str | None = None
    participant_code: str | None = None
    first_day: date | None = None
    last_day: date | None = None
    food_keys: tuple[str, ...] = ()
    statuses: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    origin: Literal["photographed", "declared"] | None = None
    needs: Literal["review", "answer"] | None = None
    failure_codes: tuple[str, ...] = ()
    after_statuses: tuple[str, ...] = ()
    participant_id: uuid.UUID | None = None
    study_ids: frozenset[uuid.UUID] | None = None

    @property
    def set_names(self) -> list[str]:
        """Names of the filters that are set; what the caller may see is no filter of theirs."""
        names = (each.name for each in fields(self) if each.name != "study_ids")
        return sorted(name for name in names if getattr(self, name) not in (None, ()))


WIRE_NAMES: Mapping[str, str] = {  # a field of RowFilter -> its parameter
    "study_code": "study",
    "participant_code": "participant",
    "first_day": "from",
    "last_day": "to",
    "food_keys": "food",
    "statuses": "status",
    "flags": "flag",
    "origin": "origin",
    "needs": "needs",
    "failure_codes": "failure",
    "after_statuses": "after_status",
}
