"""The checks of an app, one file per idea: each judges a recorded conversation, and does nothing else."""

from collections.abc import Callable

from app.extras.conformance.checks.both_photographs import check_both_photographs
from app.extras.conformance.checks.durable import check_durable
from app.extras.conformance.checks.erasure import check_erasure
from app.extras.conformance.checks.etags import check_etags
from app.extras.conformance.checks.exif import check_exif
from app.extras.conformance.checks.ids import check_ids
from app.extras.conformance.checks.resume import check_resume
from app.extras.conformance.checks.retry_after import check_retry_after
from app.extras.conformance.checks.safe_resending import check_safe_resending
from app.extras.conformance.checks.time_zones import check_time_zones
from app.extras.conformance.checks.tokens import check_tokens
from app.extras.conformance.checks.unknown_fields import check_unknown_fields
from app.extras.conformance.conversation import Conversation
from app.extras.conformance.verdict import Result, Verdict

CHECKS: tuple[
    tuple[str, str, Callable[[Conversation], Verdict], bool], ...
] = (  # the last: is it required
    ("ids", "The phone makes each meal's id, once", check_ids, True),
    (
        "safe_resending",
        "A meal is sent again after a lost answer, unchanged",
        check_safe_resending,
        True,
    ),
    ("resume", "A broken upload continues with what is missing", check_resume, True),
    ("durable", "A photograph is kept until the server calls it durable", check_durable, True),
    ("etags", "Changes name the version that they were made from", check_etags, True),
    ("retry_after", "Retry-After is obeyed", check_retry_after, True),
    ("unknown_fields", "Unknown fields of answers are ignored", check_unknown_fields, True),
    ("both_photographs", "Both photographs of a meal arrive", check_both_photographs, True),
    (
        "time_zones",
        "The time of a meal is its own, with the zone of the place",
        check_time_zones,
        True,
    ),
    ("tokens", "No token or enrolment code stands in an address", check_tokens, True),
    ("erasure", "What was erased is not sent again", check_erasure, True),
    ("exif", "Photographs are HEIC or JPEG, with their EXIF", check_exif, False),
)


def judge(conversation: Conversation) -> list[Result]:
    """Return the verdict of every check."""
    return [
        Result(name, title, check(conversation), is_required)
        for name, title, check, is_required in CHECKS
    ]
