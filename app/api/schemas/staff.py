"""Staff, their sessions, tokens and roles over the wire. Passwords never come back."""

import uuid
from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, SecretStr

from app.api.schemas.text import Text
from app.services.access_tokens import MAX_DAYS
from app.services.passwords import MAX_LENGTH, MIN_LENGTH

RoleName = Literal["viewer", "reviewer", "owner"]
StaffName = Annotated[Text, Field(min_length=1, max_length=200)]
NewPassword = Annotated[SecretStr, Field(max_length=1000, description=f"{MIN_LENGTH} to {MAX_LENGTH} characters.")]
Password = Annotated[SecretStr, Field(max_length=1000)]


class SessionIn(BaseModel):
    """Name and password."""

    model_config = ConfigDict(extra="forbid")

    name: StaffName
    password: Password


class SessionIssued(BaseModel):
    """A session's token, shown once. It ends at expires_at, or when it was not used for idle_minutes."""

    token: str
    name: str
    is_admin: bool
    expires_at: datetime
    idle_minutes: int


class SessionOut(BaseModel):
    """Who is signed in. roles: study -> role; an admin may do everything in every study."""

    name: str
    is_admin: bool
    roles: dict[str, str]
    expires_at: datetime


class PasswordChangeIn(BaseModel):
    """The password that is, and the one that shall be."""

    model_config = ConfigDict(extra="forbid")

    current_password: Password
    new_password: NewPassword


class StaffIn(BaseModel):
    """A new staff member. Without a password they cannot sign in until they are given one."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"name": "m.keller"}})

    name: StaffName
    is_admin: bool = False
    password: NewPassword | None = None


class StaffPatch(BaseModel):
    """A change of a staff member; null leaves as it is. Disabling ends sessions and tokens for good."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"is_disabled": True}})

    is_admin: bool | None = None
    is_disabled: bool | None = None
    password: NewPassword | None = None


class StaffOut(BaseModel):
    """A staff member."""

    name: str
    is_admin: bool
    has_password: bool
    disabled_at: datetime | None
    created_at: datetime


class EndedAccessOut(BaseModel):
    """What a new password or the end of an account has ended."""

    sessions: int = Field(description="How many sessions.")
    tokens: list[str] = Field(description="The names of the personal tokens that open nothing any more.")


class StaffChangedOut(StaffOut):
    """A staff member after a change, and what they had open that it ended."""

    ended: EndedAccessOut


class StaffList(BaseModel):
    """A page of staff by name."""

    items: list[StaffOut]
    next: str | None


class MemberIn(BaseModel):
    """A role in a study; each may do all that the one before it may."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"role": "reviewer"}})

    role: RoleName


class MemberOut(BaseModel):
    """Somebody's role in a study."""

    name: str
    role: str
    is_disabled: bool
    since: datetime


class MemberList(BaseModel):
    """A page of a study's members by name."""

    items: list[MemberOut]
    next: str | None


class TokenIn(BaseModel):
    """A new personal token. study: the only study that it reaches; null: all of its maker's."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"example": {"name": "nightly export", "scope": "read", "study": "pilot"}}
    )

    name: Text = Field(min_length=1, max_length=100, description="What it is for.")
    scope: Literal["read", "write"] = "read"
    study: Text | None = Field(default=None, max_length=64)
    days: int = Field(default=90, ge=1, le=MAX_DAYS, description="How long it is valid.")


class TokenOut(BaseModel):
    """A personal token without its secret."""

    id: uuid.UUID
    name: str
    scope: str
    study: str | None
    created_at: datetime
    expires_at: datetime | None
    last_used_at: datetime | None = Field(description="To five minutes.")


class TokenIssued(TokenOut):
    """A new personal token with its secret, shown once."""

    token: str


class TokenList(BaseModel):
    """The caller's own tokens that are valid, the newest first."""

    items: list[TokenOut]
