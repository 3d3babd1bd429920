"""The checks of an app: each judges a recorded conversation, and does nothing else."""

import re
from collections import defaultdict
from collections.abc import Callable, Mapping
from datetime import datetime
from zoneinfo import ZoneInfo

from app.extras.conformance.conversation import GRACE_SECONDS, Conversation, Exchange
from app.extras.conformance.verdict import Result, Verdict, failed, name_of, not_seen, passed

LEAST_MEALS = 2
_CHANGE = re.compile(r"^/v1/meals/[^/]+/events$|^/v1/me/days/[^/]+$")
TOLERANCE_SECONDS = 0.2  # the phone's clock starts when the answer arrives
STUCK = 4  # times the same call, answered and unanswered by what should follow
PAIR = {"left", "right"}
LEAST_CALLS = 5
UNDER_WAY_SECONDS = 2.0  # requests that were sent before the answer was read
LEAVING = "/v1/me/withdrawal"
HEIC, JPEG = "image/heic", "image/jpeg"


def check_ids(conversation: Conversation) -> Verdict:
    """Ids of meals are made by the phone, once per meal: sending again doubles nothing.

    Fail for a photograph that comes again under another id, and for an id that is used for two meals.
    """
    reused = next(
        (exchange for exchange in conversation.exchanges if exchange.code == "meal_id_reused"), None
    )
    if reused is not None:
        return failed(f"The id {reused.meal} came again with other content ({reused.call}).")
    captured_at = {
        exchange.meal: exchange.metadata.get("captured_at")
        for exchange in conversation.exchanges
        if exchange.metadata is not None
    }
    ids: dict[tuple[str, object], set[str | None]] = defaultdict(set)
    for exchange in conversation.exchanges:
        for photograph in exchange.photographs:
            ids[photograph.sha256, captured_at.get(exchange.meal)].add(exchange.meal)
    doubled = next((meals for meals in ids.values() if len(meals) > 1), None)
    if doubled is not None:
        return failed(
            f"One photograph came under several ids: {', '.join(sorted(map(str, doubled)))}."
        )
    count = len(conversation.complete_meals)
    if count < LEAST_MEALS:
        return not_seen(f"Send {LEAST_MEALS} meals; {count} arrived.")
    return passed(f"{count} meals, each with an id of its own.")


def check_safe_resending(conversation: Conversation) -> Verdict:
    """A request whose answer was lost is sent again as it was: the server knows it by its id.

    Fail if the metadata did not come again after a lost answer, or came changed.
    """
    lost = next(conversation.with_fault("lost_answer"), None)
    if lost is None:
        return not_seen("The answer to the first meal's metadata is lost: send a meal.")
    again = conversation.again(lost)
    if again is None:
        return _awaited(conversation, lost, f"The answer to {lost.call} was lost")
    if again.metadata != lost.metadata:
        return failed(f"{again.call} came again with other metadata.")
    return passed(f"{again.call} came again unchanged, and was answered {again.status}.")


def check_resume(conversation: Conversation) -> Verdict:
    """After a broken upload the phone sends what is missing, and nothing that is already durable.

    Fail if the broken photograph did not come again, or if a durable one is sent again by itself.
    """
    durable: set[tuple[str, str]] = set()
    for exchange in conversation.exchanges:
        if exchange.content in durable and exchange.method == "PUT":
            return failed(
                f"{exchange.path} was sent again, though the server had said that it is durable."
            )
        durable |= {(exchange.meal, slot) for slot in exchange.durable if exchange.meal is not None}
    broken = next(conversation.with_fault("lost_request"), None)
    if broken is None:
        return not_seen("The upload of the first photograph is broken off: send a meal.")
    again = conversation.again(broken)
    while again is not None and not again.is_ok:
        again = conversation.again(again)
    if again is not None:
        return passed(f"{broken.path} was broken off and came again.")
    return _awaited(conversation, broken, f"{broken.path} was broken off")


def check_durable(conversation: Conversation) -> Verdict:
    """A photograph stays on the phone until the server has called it durable: one that is lost before comes again.

    Fail if photographs that were accepted, but not called durable, do not come again with the same bytes.
    """
    accepted = next(conversation.with_fault("not_durable"), None)
    if accepted is None:
        return not_seen(
            "One photograph is accepted without being durable: send two meals, or five in one request each."
        )
    if accepted.method == "PATCH":
        return _check_pieces(conversation, accepted)
    for sent in accepted.photographs:
        again = [
            photograph.sha256
            for later in conversation.after(accepted)
            for photograph in later.photographs
            if later.meal == accepted.meal and photograph.slot == sent.slot
        ]
        if any(sha256 != sent.sha256 for sha256 in again):
            return failed(f"{sent.slot} of the meal {accepted.meal} came again with other bytes.")
        if not again:
            event = f"{sent.slot} of the meal {accepted.meal} was `missing` in the answer"
            return _awaited(conversation, accepted, event)
    return passed("A photograph that was not durable was kept, and came again with the same bytes.")


def check_etags(conversation: Conversation) -> Verdict:
    """A change names the version that it was made from (If-Match); a refused one is made anew from the meal as it is.

    Fail for a change without If-Match, and for one that is repeated with a version that was refused.
    """
    changes = [
        exchange
        for exchange in conversation.exchanges
        if exchange.method != "GET" and _CHANGE.match(exchange.path)
    ]
    without = next((change for change in changes if change.if_match is None), None)
    if without is not None:
        return failed(f"{without.call} came without If-Match.")
    refused = next((change for change in changes if change.fault == "stale"), None)
    if refused is None:
        return not_seen(
            "The first change of a meal is answered as if the meal had changed: confirm or correct a food."
        )
    for later in conversation.after(refused):
        if later.meal != refused.meal:
            continue
        if later.method == "GET" or later.if_match != refused.if_match:
            return passed(
                "Changes name their version, and a refused one was followed by reading the meal."
            )
        if later in changes:
            return failed(f"{later.call} came again with the version that was refused.")
    if conversation.is_overdue(refused):
        return failed(
            f"{refused.path} was refused because the meal had changed, and the meal was not read again."
        )
    return not_seen(
        f"{refused.path} was refused because the meal had changed; it was not read again yet."
    )


def check_retry_after(conversation: Conversation) -> Verdict:
    """429 and 503 say how long to wait, and the phone waits for so long.

    Fail for a request that comes again too early, or not at all.
    """
    waited = 0
    for refused in conversation.exchanges:
        if refused.status not in {429, 503} or refused.retry_after is None:
            continue
        again = conversation.again(refused)
        if again is None:
            if conversation.is_overdue(refused, refused.retry_after + GRACE_SECONDS):
                return failed(
                    f"{refused.call} was answered {refused.status} and did not come again."
                )
            continue
        pause = again.at - refused.ended_at
        if pause < refused.retry_after - TOLERANCE_SECONDS:
            return failed(
                f"{refused.call} came again after {pause:.1f} s, "
                f"Retry-After was {refused.retry_after:g}."
            )
        waited += 1
    if waited:
        return passed(f"Refused requests that came again no earlier than Retry-After: {waited}.")
    return not_seen("A photograph is answered 503, and the next meal 429: send two meals.")


def check_unknown_fields(conversation: Conversation) -> Verdict:
    """Answers may have fields that the app does not know: all of the observer's have one.

    Fail if the same request comes again and again, though each was carried out: its answer was not understood.
    """
    runs: dict[str, tuple[tuple[str, str], int]] = {}
    for exchange in conversation.exchanges:
        if exchange.meal is None or exchange.method == "GET":
            continue
        call = exchange.method, exchange.path
        before, count = runs.get(exchange.meal, (call, 0))
        count = count + 1 if before == call and exchange.is_ok and exchange.fault is None else 0
        if count >= STUCK:
            return failed(
                f"{exchange.call} was answered {count} times, and the phone did not go on."
            )
        runs[exchange.meal] = call, count
    if conversation.complete_meals:
        return passed("A meal was sent whole, by answers with fields that no app knows.")
    return not_seen("Send a meal: the answers have a field that no app knows.")


def check_both_photographs(conversation: Conversation) -> Verdict:
    """A meal has two photographs, from the left and from the right, and both arrive.

    Fail for a pair of the same photograph, and for a meal that stays incomplete.
    """
    whole = 0
    announced = {
        exchange.meal: exchange
        for exchange in conversation.exchanges
        if exchange.metadata is not None and exchange.meal
    }
    for meal, first in announced.items():
        if first.metadata is None or first.metadata.get("views", 2) != 2:
            continue
        digests = {
            photograph.slot: photograph.sha256
            for exchange in conversation.exchanges
            if exchange.meal == meal
            for photograph in exchange.photographs
        }
        if digests.keys() >= PAIR and digests["left"] == digests["right"]:
            return failed(f"The photographs of the meal {meal} are the same file twice.")
        if meal in conversation.complete_meals:
            whole += 1
        elif conversation.is_overdue(first) and not _is_erased(conversation, meal):
            return failed(
                f"The meal {meal} is not complete: its photographs are {', '.join(sorted(digests)) or 'none'}."
            )
    return (
        passed(f"Pairs that arrived: {whole}.")
        if whole
        else not_seen("Send a meal with two photographs.")
    )


def check_time_zones(conversation: Conversation) -> Verdict:
    """A meal's time is that of the photograph, with the offset and the name of the zone of the place.

    Fail for a zone that is no IANA name, an offset that is not of the zone, and a time that changes.
    """
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


def check_tokens(conversation: Conversation) -> Verdict:
    """Tokens and enrolment codes travel in headers and bodies: addresses end up in logs and histories.

    Fail for an address that contains one.
    """
    leaking = next(
        (exchange for exchange in conversation.exchanges if exchange.has_secret_in_url), None
    )
    if leaking is not None:
        return failed(f"A token or an enrolment code stood in the address of {leaking.call}.")
    count = sum(exchange.is_authorised for exchange in conversation.exchanges)
    if count < LEAST_CALLS:
        return not_seen(f"{count} calls with a token; {LEAST_CALLS} are looked at.")
    return passed(f"None in the addresses of {count} calls.")


def check_erasure(conversation: Conversation) -> Verdict:
    """An erased meal is not sent again; a phone whose participant has left sends nothing.

    Fail if an erased meal comes again, or if a phone goes on calling after its participant has left.
    """
    seen = 0
    for exchange in conversation.exchanges:
        is_leaving = _ends_participation(exchange)
        if not is_leaving and not _erases_meal(exchange):
            continue
        seen += 1
        for later in conversation.after(exchange):
            if later.at - exchange.ended_at < UNDER_WAY_SECONDS:
                continue
            if is_leaving and later.is_authorised:
                return failed(f"The participant had left, and {later.call} came with the token.")
            if later.meal == exchange.meal and later.content is not None:
                return failed(f"The meal {later.meal} was erased, and {later.call} came again.")
    if seen:
        return passed("What was erased did not come again.")
    return not_seen("Erase a meal in the app, or leave the study.")


def check_exif(conversation: Conversation) -> Verdict:
    """Photographs are sent as the camera wrote them: HEIC or JPEG, with the EXIF from which the focal length is read.

    Advise against other formats, and against photographs without EXIF, for which the phone must be calibrated.
    """
    photographs = [
        photograph for exchange in conversation.exchanges for photograph in exchange.photographs
    ]
    for photograph in photographs:
        if photograph.media_type not in {HEIC, JPEG}:
            return failed(
                f"{photograph.slot} is {photograph.media_type or 'no photograph'}: send the camera's own file."
            )
        if not photograph.has_exif:
            return failed(
                f"{photograph.slot} has no EXIF: the focal length is then known from a calibration only."
            )
    return (
        passed(f"{len(photographs)} photographs as a camera writes them.")
        if photographs
        else not_seen("Send a meal.")
    )


CHECKS: Mapping[Callable[[Conversation], Verdict], str] = {
    check_ids: "The phone makes each meal's id, once",
    check_safe_resending: "A meal is sent again after a lost answer, unchanged",
    check_resume: "A broken upload continues with what is missing",
    check_durable: "A photograph is kept until the server calls it durable",
    check_etags: "Changes name the version that they were made from",
    check_retry_after: "Retry-After is obeyed",
    check_unknown_fields: "Unknown fields of answers are ignored",
    check_both_photographs: "Both photographs of a meal arrive",
    check_time_zones: "The time of a meal is its own, with the zone of the place",
    check_tokens: "No token or enrolment code stands in an address",
    check_erasure: "What was erased is not sent again",
    check_exif: "Photographs are HEIC or JPEG, with their EXIF",
}
ADVICE = frozenset({check_exif})  # all others are required


def judge(conversation: Conversation) -> list[Result]:
    """Return the verdict of every check."""
    return [
        Result(name_of(check), title, check(conversation), is_required=check not in ADVICE)
        for check, title in CHECKS.items()
    ]


def _awaited(conversation: Conversation, disturbed: Exchange, event: str) -> Verdict:
    """Judge a phone that has not sent again what it was expected to. event: what was done to it."""
    if conversation.is_overdue(disturbed):
        return failed(f"{event}, and it did not come again.")
    return not_seen(f"{event}; it has not come again yet.")


def _check_pieces(conversation: Conversation, lost: Exchange) -> Verdict:
    """Judge a photograph whose pieces the server has lost: it is to come again from its first byte."""
    is_back = any(
        later.content == lost.content
        and later.is_ok
        and (later.upload_offset == 0 or later.photographs)
        for later in conversation.after(lost)
    )
    if is_back:
        return passed(
            "A photograph whose pieces the server had lost came again from its first byte."
        )
    return _awaited(conversation, lost, f"The server lost the pieces of {lost.path}")


def _is_erased(conversation: Conversation, meal: str | None) -> bool:
    return any(
        exchange.meal == meal and (exchange.method == "DELETE" or exchange.status == 410)
        for exchange in conversation.exchanges
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


def _ends_participation(exchange: Exchange) -> bool:
    return (exchange.is_ok and exchange.path == LEAVING) or exchange.code == "withdrawn"


def _erases_meal(exchange: Exchange) -> bool:
    return exchange.meal is not None and (
        (
            exchange.is_ok
            and exchange.method == "DELETE"
            and exchange.path == f"/v1/meals/{exchange.meal}"
        )
        or exchange.code == "meal_deleted"
    )
