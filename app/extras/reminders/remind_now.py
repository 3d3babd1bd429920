"""Staff remind participants at once: a reminder falls due now, and the worker's chore sends it like any other."""

from collections.abc import Collection
from datetime import UTC, datetime

from pydantic import BaseModel, Field

from app.core.errors import ConflictError
from app.db.session import Database
from app.extras.reminders import queries
from app.extras.reminders.send_reminders import zone_of
from app.extras.reminders.subscriptions import is_quiet_for
from app.people.access import audit
from app.people.access.caller import StaffCaller
from app.people.studies import enter_study


class RemindedOut(BaseModel):
    """Participants by code. A worker sends what is due, in about half a minute."""

    reminded: list[str] = Field(description="With a phone that is being reminded.")
    unreached: list[str] = Field(
        description="Without a phone that wants reminders, or all are in their quiet hours."
    )


def remind_now(
    database: Database,
    caller: StaffCaller,
    study_code: str,
    codes: Collection[str],
    *,
    is_on: bool,
) -> RemindedOut:
    """Remind participants of their meals on all phones that want reminders and have no quiet hours now.

    Raises ConflictError (`reminders_off`), NotFoundError, NotAllowedError.
    """
    if not is_on:
        raise ConflictError("This server sends no reminders.", code="reminders_off")
    now = datetime.now(UTC)
    reminded: set[str] = set()
    with database.write() as session:
        study = enter_study(session, caller, study_code)
        for row, code in queries.of_participants(session, study.id, codes):
            zone = zone_of(row)
            if zone is not None and not is_quiet_for(row, now.astimezone(zone).time()):
                row.next_at = now
                reminded.add(code)
        audit.note(session, caller, "participants.remind", study_id=study.id, count=len(reminded))
    return RemindedOut(reminded=sorted(reminded), unreached=sorted(set(codes) - reminded))
