"""Parameters that several routes take, each described once; conditions of requests.

`If-Match` is of a change, `If-None-Match` of a look (RFC 9110, section 13).
"""

import re
import uuid
from typing import Annotated

from fastapi import Header, Path, Query

from app.core.errors import (
    MalformedRequestError,
    PreconditionFailedError,
    PreconditionRequiredError,
)
from app.http.text_schemas import LocalDay
from app.photos.slots import ImageSlot

StudyCode = Annotated[str, Path(max_length=64, description="The study's code.")]
ParticipantCode = Annotated[
    str, Path(max_length=64, description="The participant's pseudonymous code in the study.")
]
StaffName = Annotated[
    str, Path(max_length=200, description="The staff member's name, with which they sign in.")
]
ReleaseName = Annotated[str, Path(max_length=64, description="The release's name in the study.")]
ExportId = Annotated[uuid.UUID, Path(description="The export's id, from the answer that began it.")]
RemeasurementId = Annotated[uuid.UUID, Path(description="The remeasurement's id.")]
VesselId = Annotated[uuid.UUID, Path(description="The vessel's id, not its name.")]
WebhookId = Annotated[uuid.UUID, Path(description="The webhook's id.")]
Slot = Annotated[
    ImageSlot,
    Path(
        description="Which photograph: left, right and view3 to view8 of the meal, after_left and after_right of its "
        "after-meal pair; or a map: left_depth, right_depth, left_confidence, right_confidence; or voice_note."
    ),
]
OfStudy = Annotated[
    str | None,
    Query(
        alias="study",
        max_length=64,
        description="Only this study's; default: all that the caller sees.",
    ),
]
OfParticipant = Annotated[
    str | None,
    Query(alias="participant", max_length=64, description="Only this participant's, by code."),
]
FirstDay = Annotated[LocalDay | None, Query(alias="from", description="First local day, included.")]
LastDay = Annotated[LocalDay | None, Query(alias="to", description="Last local day, included.")]
MealId = Annotated[uuid.UUID, Path(description="The id that the phone made.")]
OfWhichParticipant = Annotated[
    str | None,
    Query(
        alias="participant",
        max_length=64,
        description="Staff: whose meal, if the id alone is not enough.",
    ),
]
IfMatch = Annotated[
    str | None,
    Header(
        max_length=1000,
        description="The ETag of the version that was read; * for whatever is there.",
    ),
]
_ETAG = re.compile(r'\s*(?:W/"[^"]*"|"(?P<strong>[^"]*)")\s*(?:,|\Z)')
_ETAGS = re.compile(f"(?:{_ETAG.pattern.replace('?P<strong>', '?:')})+")


def expected_versions(if_match: str | None) -> frozenset[int] | None:
    """The versions that `If-Match` names; None for *. A tag that no version has names none.

    Raises PreconditionRequiredError without the header, MalformedRequestError for what is no list
    of tags.
    """
    if if_match is None:
        raise PreconditionRequiredError(
            "Send `If-Match` with the ETag that GET gave, so that nobody's change is overwritten unseen.",
        )
    if if_match.strip() == "*":
        return None
    if not _ETAGS.fullmatch(if_match):
        raise MalformedRequestError(
            f'`If-Match` takes an ETag as GET gave it, with its quotes, such as "24": not {if_match[:40]}.'
        )
    tags = (match["strong"] or "" for match in _ETAG.finditer(if_match))
    return frozenset(int(tag) for tag in tags if tag.isascii() and tag.isdigit() and len(tag) < 19)


def require_version(version: int, expected: frozenset[int] | None, what: str) -> None:
    """Raise PreconditionFailedError unless a change may be made from this version. expected: None: from any.

    what: what was changed meanwhile, such as "study"
    """
    if expected is not None and version not in expected:
        raise PreconditionFailedError(
            f"The {what} was changed after you read it: read it again, then change it.",
            version=version,
        )


def is_held(if_none_match: str | None, etag: str) -> bool:
    """Whether the caller holds what this ETag names: `If-None-Match` is a list of tags, weak or not, or `*`."""
    tags = {tag.strip().removeprefix("W/") for tag in (if_none_match or "").split(",")}
    return bool(tags & {"*", etag})
