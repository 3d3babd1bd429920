"""Studies and their protocol: made by admins, changed by owners, each change under the version that it is of."""

import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError, PreconditionFailedError
from app.db.session import Database, unless_taken
from app.http.paging import TEXT, Page, decode_cursor, page_of
from app.people import queries as people
from app.people.access.audit import note
from app.people.access.caller import Caller, StaffCaller, known_studies, require_study
from app.people.location_policy import FilesWithPlaces
from app.people.models import Study
from app.vision.marker_spec import parse_marker

PROTOCOL = frozenset(
    {
        "name",
        "marker",
        "camera",
        "expects_after_pair",
        "after_window_minutes",
        "location_policy",
        "location_decimals",
        "retention_days",
        "withdrawal_policy",
        "locale",
        "gives_feedback",
        "day_starts_minutes",
        "shares_index",
    }
)


def create_study(database: Database, *, code: str, name: str, caller: Caller | None = None, **protocol: Any) -> Study:
    """A new study. protocol: columns of PROTOCOL, the rest by default.

    Raises ConflictError if the code is taken, InvalidInputError for a protocol that contradicts itself.
    """
    taken = ConflictError(f"There is already a study {code!r}.", code="study_exists")
    study = Study(id=uuid.uuid4(), code=code, change_seq=0, version=1, created_at=datetime.now(UTC))
    study.location_policy, study.location_decimals = "drop", None
    _apply(study, {"name": name, **protocol})
    with unless_taken(taken), database.write() as session:
        session.add(study)
        session.flush()
        note(session, caller, "study.create", study_id=study.id, subject=code, fields=sorted(protocol))
    return study


def list_studies(database: Database, caller: StaffCaller, *, cursor: str | None, limit: int) -> Page[Study]:
    """The studies where the caller has a role, by code; all of them for an admin."""
    known, after = known_studies(caller), decode_cursor("studies", cursor, TEXT)
    with database.read() as session:
        rows = people.page_of_studies(session, known, after=after, limit=limit + 1)
    return page_of("studies", rows, limit, lambda study: study.code)


def known_codes(database: Database, caller: StaffCaller) -> list[str]:
    """The codes of all studies that `list_studies` lists, in its order."""
    with database.read() as session:
        return people.known_study_codes(session, known_studies(caller))


def read_study(database: Database, code: str) -> Study:
    """A study. Raises NotFoundError."""
    with database.read() as session:
        return known_study(people.find_study(session, code))


def change_study(
    database: Database,
    caller: StaffCaller,
    code: str,
    changes: Mapping[str, Any],
    *,
    expected: frozenset[int] | None,
    files_with_places: FilesWithPlaces,
) -> Study:
    """Change the protocol: only the columns named. expected: the versions that the change may be of; None: any.

    Raises NotFoundError, PreconditionFailedError (changed since), InvalidInputError (a protocol that contradicts
    itself), ConflictError (`day_start_fixed`: meals have been given their day already).
    """
    with database.write() as session:
        study = known_study(people.find_study(session, code, lock=True))
        if expected is not None and study.version not in expected:
            raise PreconditionFailedError(
                "The study was changed after you read it: read it again, then change it.", version=study.version
            )
        day_started = study.day_starts_minutes
        changed = _apply(study, changes)
        if study.day_starts_minutes != day_started and people.has_meals(session, study.id):
            raise ConflictError(
                "The day's start is fixed: meals of this study have been given their local day already.",
                code="day_start_fixed",
            )
        if "location_policy" in changed and study.location_policy == "drop":
            files_with_places(session, study)
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
    """The study of this code, which the caller may enter. Raises NotFoundError, NotAllowedError (a role too low)."""
    study = known_study(people.find_study(session, code))
    require_study(caller, study.id)
    return study


def known_study(study: Study | None) -> Study:
    """The study that was asked for. Raises NotFoundError."""
    if study is None:
        raise NotFoundError("There is no such study.")
    return study


def _apply(study: Study, changes: Mapping[str, Any]) -> list[str]:
    """Set the columns; which of them differ now. Raises InvalidInputError for a protocol that contradicts itself."""
    unknown = changes.keys() - PROTOCOL
    if unknown:
        raise ValueError(f"no settings of a protocol: {', '.join(sorted(unknown))}")
    values = dict(changes)
    if values.get("marker") is not None:
        parse_marker(values["marker"])
    if values.get("location_policy", "round") != "round":
        values.setdefault("location_decimals", None)  # they go with the rounding that they were of
    changed = sorted(name for name, value in values.items() if getattr(study, name) != value)
    for name in changed:
        setattr(study, name, values[name])
    if (study.location_policy == "round") != (study.location_decimals is not None):
        raise InvalidInputError(
            "location_decimals goes with the policy round, and the policy round with location_decimals: the decimals "
            "of a degree that are kept."
        )
    return changed
