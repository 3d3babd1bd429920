"""Personal API tokens for scripts, created by signed-in staff; a token never has more rights than its creator has."""

import uuid
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, NotFoundError
from app.db.session import Database
from app.people import queries as people
from app.people.access.audit import note
from app.people.access.caller import StaffCaller, new_token, sha256_hex, studies_with_role
from app.people.access.staff_schemas import TokenOut
from app.people.models import AccessToken, Scope, Staff

MAX_TOKENS = 50  # valid tokens per person, which also keeps the list short


@dataclass(frozen=True, slots=True)
class EndedAccess:
    """The number of sessions and the names of personal tokens ended by a new password or a disabled account."""

    sessions: int = 0
    tokens: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """A sentence listing them, with a leading space; empty if nothing was ended."""
        ended = (
            []
            if not self.sessions
            else ["1 session" if self.sessions == 1 else f"{self.sessions} sessions"]
        )
        if self.tokens:
            ended.append(
                ("the token " if len(self.tokens) == 1 else "the tokens ") + ", ".join(self.tokens)
            )
        return f" Ended: {' and '.join(ended)}." if ended else ""


def end_access(session: Session, staff: Staff, now: datetime) -> EndedAccess:
    """End a staff member's sessions and tokens, and the link to an account of their institution.

    Someone who knew the old password may have created some.
    """
    staff.oidc_identity = None
    ended = people.end_access_of_staff(session, staff.id, now)
    names = sorted(row.name or "" for row in ended if row.kind == "personal")
    return EndedAccess(sum(row.kind == "session" for row in ended), tuple(names))


def create_token(
    database: Database,
    caller: StaffCaller,
    *,
    name: str,
    scope: Scope,
    study_code: str | None,
    days: int,
) -> tuple[str, TokenOut]:
    """Create a token. Returns it, to be shown once, and its description.

    Its rights follow its creator's roles at each call, restricted by scope and study. Raises
    NotFoundError (a study in which they have no role), ConflictError (`too_many_tokens`).
    """
    token, now, study_ids = new_token(), datetime.now(UTC), studies_with_role(caller)
    with database.write() as session:
        study = people.find_study(session, study_code) if study_code is not None else None
        if study_code is not None and (
            study is None or (study_ids is not None and study.id not in study_ids)
        ):
            raise NotFoundError("There is no such study.")
        # concurrent calls must not pass the limit
        session.get_one(Staff, caller.staff_id, with_for_update=True)
        if len(people.personal_tokens(session, caller.staff_id, now)) >= MAX_TOKENS:
            raise ConflictError(
                f"You have {MAX_TOKENS} tokens, the limit: delete one that you do not use.",
                code="too_many_tokens",
            )
        row = AccessToken(
            id=uuid.uuid4(),
            token_sha256=sha256_hex(token),
            kind="personal",
            name=name,
            scope=scope,
            study_id=study.id if study is not None else None,
            staff_id=caller.staff_id,
            created_at=now,
            expires_at=now + timedelta(days=days),
        )
        session.add(row)
        note(
            session,
            caller,
            "token.create",
            study_id=row.study_id,
            subject=row.id,
            scope=scope,
            days=days,
        )
    return token, _view(row, study_code)


def list_tokens(database: Database, caller: StaffCaller) -> list[TokenOut]:
    """Return the caller's valid tokens, the newest first: at most MAX_TOKENS and those of the command line."""
    with database.read() as session:
        rows = people.personal_tokens(session, caller.staff_id, datetime.now(UTC))
        codes = people.codes_of_studies(
            session, [row.study_id for row in rows if row.study_id is not None]
        )
    return [
        _view(row, codes.get(row.study_id) if row.study_id is not None else None) for row in rows
    ]


def revoke_token(database: Database, caller: StaffCaller, token_id: uuid.UUID) -> None:
    """End one of the caller's tokens; repeating it changes nothing. Raises NotFoundError."""
    with database.write() as session:
        row = session.get(AccessToken, token_id)
        if row is None or row.staff_id != caller.staff_id or row.kind != "personal":
            raise NotFoundError("You have no such token.")
        if row.revoked_at is None:
            row.revoked_at = datetime.now(UTC)
            note(session, caller, "token.revoke", study_id=row.study_id, subject=row.id)


def _view(row: AccessToken, study_code: str | None) -> TokenOut:
    return TokenOut(
        id=row.id,
        name=row.name or "",
        scope=row.scope,
        study=study_code,
        created_at=row.created_at,
        expires_at=row.expires_at,
        last_used_at=row.last_used_at,
    )
