"""A meal's time is that of the photograph, with the offset and the name of the zone of the place."""

from datetime import datetime
from zoneinfo import ZoneInfo

from app.extras.conformance.conversation import Conversation
from app.extras.conformance.verdict import Verdict, failed, not_seen, passed


def check_time_zones(conversation: Conversation) -> Verdict:
    """Fail for a zone that is no IANA name, an offset that is not of the zone, and a time that changes."""
    times: dict[str, object] = {}
    for exchange in conversation.exchanges:
        if exchange.metadata is None or exchange.meal is None or exchange.content is None:
            continue
        captured_at, zone = exchange.metadata.get("captured_at"), exchange.metadata.get("time_zone")
        if times.setdefault(exchange.meal, captured_at) != captured_at:
            return failed(
                f"`captured_at` of the meal {exchange.meal} changed when it was sent again: is it the time of sending?"
            )
        reason = _doubt(captured_at, zone)
        if reason is not None:
            return failed(f"The meal {exchange.meal}: {reason}.")
    return (
        passed(f"Meals with the time and zone of their place: {len(times)}.")
        if times
        else not_seen("Send a meal.")
    )


def _doubt(captured_at: object, zone: object) -> str | None:
    try:
        instant = datetime.fromisoformat(str(captured_at))
    except ValueError:
        return f"`captured_at` is {captured_at!r}, no time"
    if instant.utcoffset() is None:
        return f"`captured_at` {captured_at} has no offset"
    try:
        local = instant.astimezone(ZoneInfo(str(zone)))
    except (ValueError, OSError, KeyError):
        return f"`time_zone` is {zone!r}, no IANA name"
    if instant.utcoffset() != local.utcoffset() and not str(captured_at).upper().endswith("Z"):
        return f"the offset of {captured_at} is not that of {zone}"
    return None
