"""HTTP schemas of staff, their sessions, tokens and roles. Passwords are never returned."""

import uuid
from datetime import datetime
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, SecretStr

from app.http.closed_model import ClosedModel
from app.http.field_descriptions import STAFF_NAME
from app.http.page_of import PageOf
from app.http.text_schemas import Text
from app.people.access.passwords import MAX_LENGTH, MIN_LENGTH
from app.people.models import Role, Scope

MAX_DAYS = 365  # of a token

StaffName = Annotated[Text, Field(min_length=1, max_length=200)]
NewPassword = Annotated[
    SecretStr, Field(max_length=1000, description=f"{MIN_LENGTH} to {MAX_LENGTH} characters.")
]
Password = Annotated[SecretStr, Field(max_length=1000)]


class SessionIn(ClosedModel):
    """Name, password and, for those who have turned it on, a code of their app."""

    name: StaffName = Field(description=STAFF_NAME)
    password: Password = Field(description="The staff member's password.")
    code: str = Field(
        default="",
        max_length=20,
        description="The code that their app shows, if they have turned codes on.",
    )


class SessionIssued(BaseModel):
    """A session's token, shown once. It ends at expires_at, or after idle_minutes without use."""

    token: str = Field(description="Send it as `Authorization: Bearer TOKEN`. Shown once.")
    name: str = Field(description=STAFF_NAME)
    is_admin: bool = Field(description="Whether they may do everything in every study.")
    expires_at: datetime = Field(description="When the session ends at the latest.")
    idle_minutes: int = Field(description="The session ends after so many minutes without use.")


class SessionOut(BaseModel):
    """The signed-in staff member."""

    name: str = Field(description=STAFF_NAME)
    is_admin: bool = Field(description="Whether they may do everything in every study.")
    roles: dict[str, Role] = Field(description="Role by study code.")
    expires_at: datetime = Field(description="When the session or token ends at the latest.")


class PasswordChangeIn(ClosedModel):
    """The current and the new password."""

    current_password: Password = Field(description="The current password.")
    new_password: NewPassword


class StaffIn(ClosedModel):
    """A new staff member, who cannot sign in without a password."""

    model_config = ConfigDict(json_schema_extra={"example": {"name": "m.keller"}})

    name: StaffName = Field(description=STAFF_NAME)
    is_admin: bool = Field(
        default=False, description="Whether they may do everything in every study."
    )
    password: NewPassword | None = Field(
        default=None,
        description="The first password; null: they cannot sign in until they get one.",
    )


class StaffPatch(ClosedModel):
    """A change of a staff member; null leaves a field unchanged. Disabling ends sessions and tokens permanently."""

    model_config = ConfigDict(json_schema_extra={"example": {"is_disabled": True}})

    is_admin: bool | None = Field(
        default=None, description="Whether they may do everything in every study; null: unchanged."
    )
    is_disabled: bool | None = Field(
        default=None,
        description="true ends all sessions and tokens permanently; false lets them sign in again; null: unchanged.",
    )
    password: NewPassword | None = Field(
        default=None, description="A new password; null: unchanged."
    )
    ends_totp: bool = Field(
        default=False,
        description="true turns off the codes that they are asked for, as after the loss of their phone.",
    )


class StaffOut(BaseModel):
    """A staff member."""

    name: str = Field(description=STAFF_NAME)
    is_admin: bool = Field(description="Whether they may do everything in every study.")
    has_password: bool = Field(
        description="Whether they have a password; without one they cannot sign in."
    )
    has_totp: bool = Field(description="Whether signing in needs a code of their app, too.")
    disabled_at: datetime | None = Field(
        description="When they were disabled; null: they may sign in."
    )
    created_at: datetime = Field(description="When the staff member was created.")


class EndedAccessOut(BaseModel):
    """The sessions and tokens that a new password or a disabled account has ended."""

    sessions: int = Field(description="Number of sessions ended.")
    tokens: list[str] = Field(description="Names of the personal tokens ended.")


class StaffChangedOut(StaffOut):
    """A staff member after a change, and the sessions and tokens that it ended."""

    ended: EndedAccessOut = Field(description="Sessions and tokens that the change ended.")


class StaffList(PageOf[StaffOut]):
    """A page of staff by name."""


class MemberIn(ClosedModel):
    """A role in a study; each role includes the rights of the one before it."""

    model_config = ConfigDict(json_schema_extra={"example": {"role": "reviewer"}})

    role: Role = Field(
        description="viewer reads; reviewer also reviews meals; owner also manages the study."
    )


class MemberOut(BaseModel):
    """A staff member's role in a study."""

    name: str = Field(description=STAFF_NAME)
    role: Role = Field(
        description="viewer reads; reviewer also reviews meals; owner also manages the study."
    )
    is_disabled: bool = Field(description="Whether the staff member may not sign in.")
    since: datetime = Field(description="When they became a member.")


class MemberList(PageOf[MemberOut]):
    """A page of a study's members by name."""


class TokenIn(ClosedModel):
    """A new personal token."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {"name": "nightly export", "scope": "read", "study": "pilot"}
        },
    )

    name: Text = Field(min_length=1, max_length=100, description="The token's purpose.")
    scope: Scope = Field(
        default="read", description="read: reading only. write: all rights of its creator."
    )
    study: Text | None = Field(
        default=None,
        max_length=64,
        description="Code of the only study that it gives access to; null: all of its creator's.",
    )
    days: int = Field(default=90, ge=1, le=MAX_DAYS, description="How many days it is valid.")


class TokenOut(BaseModel):
    """A personal token without its secret."""

    id: uuid.UUID = Field(description="The token's id.")
    name: str = Field(description="The token's purpose.")
    scope: Scope = Field(description="read: reading only. write: all rights of its creator.")
    study: str | None = Field(
        description="Code of the only study that it gives access to; null: all of its creator's."
    )
    created_at: datetime = Field(description="When it was created.")
    expires_at: datetime | None = Field(description="When it expires; null: never.")
    last_used_at: datetime | None = Field(
        description="When it was last used, accurate to five minutes."
    )


class TokenIssued(TokenOut):
    """A new personal token with its secret, shown once."""

    token: str = Field(description="Send it as `Authorization: Bearer TOKEN`. Shown once.")


class TokenList(BaseModel):
    """The caller's valid tokens, the newest first."""

    items: list[TokenOut] = Field(description="The valid tokens.")
