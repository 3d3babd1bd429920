"""Create, list and change studies and their protocol; a change names the version that it was made from."""

import uuid
from datetime import UTC, datetime
from typing import Any, TypedDict

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.db.session import Database, unless_taken
from app.http.paging import TEXT, Page, decode_cursor, page_of
from app.http.parameters import require_version
from app.people import queries as people
from app.people.access.audit import note
from app.people.access.caller import Caller, StaffCaller, require_study, studies_with_role
from app.people.access.web_origins import parse_origin
from app.people.location_policy import FilesWithPlaces
from app.people.models import CameraDetails, Locale, LocationPolicy, Study, WithdrawalPolicy
from app.vision.marker_spec import parse_marker


class ProtocolChange(TypedDict, total=False):
    """Columns of Study to set."""

    name: str
    marker: str | None
    camera: CameraDetails | None
    expects_after_pair: bool
    after_window_minutes: int
    location_policy: LocationPolicy
    location_decimals: int | None
    retention_days: int | None
    withdrawal_policy: WithdrawalPolicy
    locale: Locale
    gives_feedback: bool
    day_starts_minutes: int
    shares_index: bool
    identifies_by_context: bool
    web_origins: list[str] | None
    reminder_times: list[str] | None
    double_review: dict[str, Any] | None


def create_study(
    database: Database,
    *,
    code: str,
    name: str,
    caller: Caller | None = None,
    protocol: ProtocolChange | None = None,
    is_sandbox: bool = False,
) -> Study:
    """Create a study. is_sandbox: for good, so that no real participant is ever in one.

    Raises ConflictError (`study_exists`), InvalidInputError for a protocol that contradicts itself.
    """
    conflict = ConflictError(f"There is already a study {code!r}.", code="study_exists")
    protocol = protocol or {}
    study = Study(
        id=uuid.uuid4(), code=code, name=name, change_seq=0, version=1, created_at=datetime.now(UTC)
    )
    study.location_policy, study.location_decimals = "drop", None
    study.shares_index, study.withdrawal_policy, study.is_sandbox = False, "erase", is_sandbox
    _apply(study, protocol)
    with unless_taken(conflict), database.write() as session:
        session.add(study)
        session.flush()
        fields = sorted(protocol) + ["sandbox"] * is_sandbox
        note(session, caller, "study.create", study_id=study.id, subject=code, fields=fields)
    return study


def list_studies(
    database: Database, caller: StaffCaller, *, cursor: str | None, limit: int
) -> Page[Study]:
    """Return a page of the studies in which the caller has a role, by code; all studies for an admin."""
    study_ids, after = studies_with_role(caller), decode_cursor("studies", cursor, TEXT)
    with database.read() as session:
        rows = people.page_of_studies(session, study_ids, after=after, limit=limit + 1)
    return page_of("studies", rows, limit, lambda study: study.code)


def list_study_codes(database: Database, caller: StaffCaller) -> list[str]:
    """Return the codes of all studies that `list_studies` lists, in the same order."""
    with database.read() as session:
        return people.study_codes(session, studies_with_role(caller))


def read_study(database: Database, code: str) -> Study:
    """Return a study. Raises NotFoundError."""
    with database.read() as session:
        return load_study(session, code)


def change_study(
    database: Database,
    caller: StaffCaller,
    code: str,
    changes: ProtocolChange,
    *,
    expected: frozenset[int] | None,
    files_with_places: FilesWithPlaces,
) -> Study:
    """Change the protocol. expected: versions that the change may be made from; None: any.

    Raises NotFoundError, PreconditionFailedError (changed since), InvalidInputError (a protocol
    that contradicts itself), ConflictError (`day_start_fixed`: meals already have a local day).
    """
    with database.write() as session:
        study = load_study(session, code, lock=True)
        require_version(study.version, expected, "study")
        day_started = study.day_starts_minutes
        changed = _apply(study, changes)
        if study.day_starts_minutes != day_started and people.has_meals(session, study.id):
            raise ConflictError(
                "The day's start is fixed, because meals of this study already have a local day.",
                code="day_start_fixed",
            )
        if "location_policy" in changed and study.location_policy == "drop":
            files_with_places(session, study)
        if "reminder_times" in changed:
            people.unschedule_reminders(session, study.id)
        if changed:
            study.version += 1
            note(
                session,
                caller,
                "study.change",
                study_id=study.id,
                subject=code,
                fields=changed,
                version=study.version,
            )
        return study


def enter_study(session: Session, caller: Caller, code: str) -> Study:
    """Return a study that the caller may enter.

    Raises NotFoundError, NotAllowedError (`role_too_low`).
    """
    study = load_study(session, code)
    require_study(caller, study.id)
    return study


def load_study(session: Session, code: str, *, lock: bool = False) -> Study:
    """Return the study with a code, locked until commit if `lock` is set. Raises NotFoundError."""
    study = people.find_study(session, code, lock=lock)
    if study is None:
        raise NotFoundError("There is no such study.")
    return study


def _apply(study: Study, changes: ProtocolChange) -> list[str]:
    """Set the columns. Returns the names of those that changed.

    Raises InvalidInputError for a protocol that contradicts itself.
    """
    values = changes.copy()
    marker = values.get("marker")
    if marker is not None:
        parse_marker(marker)
    origins = values.get("web_origins")
    if origins is not None:
        values["web_origins"] = sorted({parse_origin(origin) for origin in origins}) or None
    times = values.get("reminder_times")
    if times is not None:
        values["reminder_times"] = sorted(set(times)) or None
    if values.get("location_policy", "round") != "round":
        values.setdefault("location_decimals", None)  # without rounding, its decimals go
    changed = []
    for name, value in values.items():
        if getattr(study, name) != value:
            setattr(study, name, value)
            changed.append(name)
    if (study.location_policy == "round") != (study.location_decimals is not None):
        raise InvalidInputError(
            "Set location_decimals, the decimals of a degree to keep, with the location policy round, and only with it."
        )
    if study.is_sandbox and (study.shares_index or study.withdrawal_policy != "erase"):
        raise InvalidInputError(
            "A sandbox study cannot share its index (shares_index), and its withdrawal_policy can only be erase."
        )
    return sorted(changed)
