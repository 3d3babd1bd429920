"""Staff, their sessions, tokens and roles over the wire. Passwords never come back."""

import uuid
from datetime import datetime
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, SecretStr

from app.http.field_descriptions import NEXT, PAGE, STAFF_NAME
from app.http.text_schemas import Text
from app.people.access.access_tokens import MAX_DAYS
from app.people.access.passwords import MAX_LENGTH, MIN_LENGTH
from app.people.models import Role, Scope

StaffName = Annotated[Text, Field(min_length=1, max_length=200)]
NewPassword = Annotated[SecretStr, Field(max_length=1000, description=f"{MIN_LENGTH} to {MAX_LENGTH} characters.")]
Password = Annotated[SecretStr, Field(max_length=1000)]


class SessionIn(BaseModel):
    """Name and password."""

    model_config = ConfigDict(extra="forbid")

    name: StaffName = Field(description=STAFF_NAME)
    password: Password = Field(description="The staff member's password.")


class SessionIssued(BaseModel):
    """A session's token, shown once. It ends at expires_at, or when it was not used for idle_minutes."""

    token: str = Field(description="Goes into the header Authorization: Bearer TOKEN. Shown once.")
    name: str = Field(description=STAFF_NAME)
    is_admin: bool = Field(description="Whether they may do everything in every study.")
    expires_at: datetime = Field(description="When the session ends at the latest.")
    idle_minutes: int = Field(description="The session ends when it was not used for so many minutes.")


class SessionOut(BaseModel):
    """Who is signed in. roles: study -> role; an admin may do everything in every study."""

    name: str = Field(description=STAFF_NAME)
    is_admin: bool = Field(description="Whether they may do everything in every study.")
    roles: dict[str, Role] = Field(description="Study code -> role.")
    expires_at: datetime = Field(description="When the session or token ends at the latest.")


class PasswordChangeIn(BaseModel):
    """The password that is, and the one that shall be."""

    model_config = ConfigDict(extra="forbid")

    current_password: Password = Field(description="The password until now.")
    new_password: NewPassword


class StaffIn(BaseModel):
    """A new staff member. Without a password they cannot sign in until they are given one."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"name": "m.keller"}})

    name: StaffName = Field(description=STAFF_NAME)
    is_admin: bool = Field(default=False, description="Whether they may do everything in every study.")
    password: NewPassword | None = Field(
        default=None, description="The first password; null: they cannot sign in until they are given one."
    )


class StaffPatch(BaseModel):
    """A change of a staff member; null leaves as it is. Disabling ends sessions and tokens for good."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"is_disabled": True}})

    is_admin: bool | None = Field(
        default=None, description="Whether they may do everything in every study; null: as it is."
    )
    is_disabled: bool | None = Field(
        default=None,
        description="true ends all sessions and tokens for good; false lets them sign in again; null: as it is.",
    )
    password: NewPassword | None = Field(default=None, description="A new password; null: as it is.")


class StaffOut(BaseModel):
    """A staff member."""

    name: str = Field(description=STAFF_NAME)
    is_admin: bool = Field(description="Whether they may do everything in every study.")
    has_password: bool = Field(description="Whether they have a password; without one they cannot sign in.")
    disabled_at: datetime | None = Field(description="Since when they may not sign in; null: they may.")
    created_at: datetime = Field(description="When the staff member was made.")


class EndedAccessOut(BaseModel):
    """What a new password or the end of an account has ended."""

    sessions: int = Field(description="How many sessions.")
    tokens: list[str] = Field(description="The names of the personal tokens that open nothing any more.")


class StaffChangedOut(StaffOut):
    """A staff member after a change, and what they had open that it ended."""

    ended: EndedAccessOut = Field(description="Sessions and tokens that the change ended.")


class StaffList(BaseModel):
    """A page of staff by name."""

    items: list[StaffOut] = Field(description=PAGE)
    next: str | None = Field(description=NEXT)


class MemberIn(BaseModel):
    """A role in a study; each may do all that the one before it may."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"role": "reviewer"}})

    role: Role = Field(description="viewer reads; reviewer also reviews meals; owner also manages the study.")


class MemberOut(BaseModel):
    """Somebody's role in a study."""

    name: str = Field(description=STAFF_NAME)
    role: Role = Field(description="viewer reads; reviewer also reviews meals; owner also manages the study.")
    is_disabled: bool = Field(description="Whether the staff member may not sign in.")
    since: datetime = Field(description="When they were given the role.")


class MemberList(BaseModel):
    """A page of a study's members by name."""

    items: list[MemberOut] = Field(description=PAGE)
    next: str | None = Field(description=NEXT)


class TokenIn(BaseModel):
    """A new personal token. study: the only study that it reaches; null: all of its maker's."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"example": {"name": "nightly export", "scope": "read", "study": "pilot"}}
    )

    name: Text = Field(min_length=1, max_length=100, description="What it is for.")
    scope: Scope = Field(default="read", description="read: only to read. write: all that its maker may do.")
    study: Text | None = Field(
        default=None, max_length=64, description="Code of the only study that it reaches; null: all of its maker's."
    )
    days: int = Field(default=90, ge=1, le=MAX_DAYS, description="How long it is valid.")


class TokenOut(BaseModel):
    """A personal token without its secret."""

    id: uuid.UUID = Field(description="The token's id.")
    name: str = Field(description="What it is for.")
    scope: Scope = Field(description="read: only to read. write: all that its maker may do.")
    study: str | None = Field(description="Code of the only study that it reaches; null: all of its maker's.")
    created_at: datetime = Field(description="When it was made.")
    expires_at: datetime | None = Field(description="When it ends; null: it does not end by itself.")
    last_used_at: datetime | None = Field(description="To five minutes.")


class TokenIssued(TokenOut):
    """A new personal token with its secret, shown once."""

    token: str = Field(description="Goes into the header Authorization: Bearer TOKEN. Shown once.")


class TokenList(BaseModel):
    """The caller's own tokens that are valid, the newest first."""

    items: list[TokenOut] = Field(description="The tokens that are valid.")
