"""Conditions of requests: `If-Match` of a change, `If-None-Match` of a look (RFC 9110, section 13)."""

import re
from typing import Annotated

from fastapi import Header

from app.core.errors import MalformedRequestError, PreconditionRequiredError

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

    Raises PreconditionRequiredError without the header, MalformedRequestError for what is no list of tags.
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


def is_held(if_none_match: str | None, etag: str) -> bool:
    """Whether the caller holds what this ETag names: `If-None-Match` is a list of tags, weak or not, or `*`."""
    tags = {tag.strip().removeprefix("W/") for tag in (if_none_match or "").split(",")}
    return bool(tags & {"*", etag})
