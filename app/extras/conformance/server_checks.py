"""The checks of a server, in the order in which a phone makes them: each says something, and looks at the answer."""

import time
import uuid
from collections.abc import Callable, Mapping

import httpx2

from app.extras.conformance.server_phone import (
    JSON_TYPE,
    TrialPhone,
    digest,
    document,
    metadata_body,
)
from app.extras.conformance.verdict import Result, Verdict, failed, name_of, not_seen, passed

FINAL = frozenset({"estimated", "needs_review", "failed", "confirmed"})
PROBLEM_JSON = "application/problem+json"
ESTIMATE_SECONDS = 300.0
WAIT_SECONDS = 25  # of one request for the estimate
# what reading an answer of another form raises
MALFORMED = (AttributeError, LookupError, TypeError, ValueError)
SETTLE_SECONDS = 1.0  # a server may notice later that a connection has ended


def check_problems(phone: TrialPhone) -> Verdict:
    """Refusals are problem documents with a code, whoever asks."""
    answer = phone.client.get("/v1/me")
    if failure := _unless_refused(answer, 401, "unauthenticated", "GET /v1/me without a token"):
        return failure
    answer = phone.call("GET", "/v1/meals", params={"no_such_filter": "1"})
    call = "GET /v1/meals with an unknown parameter"
    failure = _unless_refused(answer, 422, "parameter_unknown", call)
    return failure or passed("Refusals are RFC 9457 problem documents with a code.")


def check_lost_answer(phone: TrialPhone) -> Verdict:
    """A meal whose answer was lost is the same meal when it comes again."""
    path = f"/v1/meals/{phone.meal}"
    phone.lose_answer("PUT", path, metadata_body(), JSON_TYPE)
    time.sleep(SETTLE_SECONDS)
    answers = [phone.put_meal(phone.meal) for _ in range(2)]
    if answers[0].status_code not in {200, 202} or answers[1].status_code != 200:
        return failed(
            f"PUT {path} again and again: {', '.join(str(answer.status_code) for answer in answers)}."
        )
    if answers[0].headers.get("etag") != answers[1].headers.get("etag"):
        return failed("The same metadata changed the meal's ETag.")
    return passed("The same metadata again are answered 200, and change nothing.")


def check_ids(phone: TrialPhone) -> Verdict:
    """An id belongs to one meal: other content is refused."""
    answer = phone.put_meal(phone.meal, captured_at="2026-11-20T13:30:00+08:00")
    failure = _unless_refused(answer, 409, "meal_id_reused", "Other metadata for the same id")
    return failure or passed("Other content is refused.")


def check_broken_upload(phone: TrialPhone) -> Verdict:
    """Half a photograph is not kept; the whole one is durable, with the digest of its bytes."""
    path = f"/v1/meals/{phone.meal}/images/left"
    phone.lose_request("PUT", path, phone.pair["left"], "application/octet-stream")
    time.sleep(SETTLE_SECONDS)
    if "left" not in phone.read().get("missing", ()):
        return failed("After half a photograph the meal's `missing` does not list it.")
    answer = phone.put_photograph("left")
    image = document(answer).get("images", {}).get("left", {})
    if answer.status_code not in {200, 202} or not image.get("durable"):
        return failed(
            f"The photograph again: {answer.status_code}, durable: {image.get('durable')}."
        )
    if image.get("received_sha256") != digest(phone.pair["left"]):
        return failed("`received_sha256` is not the digest of the bytes that were sent.")
    return passed("A broken upload leaves nothing, and the whole photograph is durable.")


def check_repeated_photograph(phone: TrialPhone) -> Verdict:
    """The same photograph again is harmless, another one is refused."""
    answer = phone.put_photograph("left")
    if answer.status_code != 200:
        return failed(f"The same photograph again: {answer.status_code}, not 200.")
    answer = phone.put_photograph("left", phone.pair["right"])
    failure = _unless_refused(answer, 409, "meal_id_reused", "Other bytes for the same photograph")
    return failure or passed("200, and 409 for others.")


def check_unknown_fields(phone: TrialPhone) -> Verdict:
    """Fields of a newer app refuse no meal, and are named."""
    answer = phone.put_meal(str(uuid.uuid4()), conformance_kit={"a": 1})
    if answer.status_code != 202:
        return failed(f"Metadata with an unknown field: {answer.status_code}.")
    ignored = document(answer).get("ignored")
    return (
        passed("Kept aside.")
        if ignored == ["conformance_kit"]
        else failed(f"`ignored` is {ignored}.")
    )


def check_time_zones(phone: TrialPhone) -> Verdict:
    """An offset that the zone does not have is refused."""
    answer = phone.put_meal(str(uuid.uuid4()), time_zone="Europe/Vienna")
    failure = _unless_refused(answer, 422, "offset_not_in_zone", "+08:00 in Europe/Vienna")
    return failure or passed("An offset of another zone is refused.")


def check_whole_meal(phone: TrialPhone) -> Verdict:
    """A meal in one request, sent twice, is one meal."""
    meal = str(uuid.uuid4())
    files = {"metadata": ("m.json", metadata_body(id=meal), JSON_TYPE)}
    files |= {slot: (f"{slot}.jpg", content, "image/jpeg") for slot, content in phone.pair.items()}
    statuses = [phone.call("POST", "/v1/meals", files=files).status_code for _ in range(2)]
    if statuses != [202, 200]:
        return failed(f"POST /v1/meals twice: {statuses[0]}, {statuses[1]}; expected 202, 200.")
    phone.call("POST", f"/v1/meals/{meal}/cancel")
    return passed("202, then 200.")


def check_estimate(phone: TrialPhone) -> Verdict:
    """With both photographs the meal is measured, and `wait` tells when."""
    answer = phone.put_photograph("right")
    if document(answer).get("missing") != []:
        return failed(f"After both photographs `missing` is {document(answer).get('missing')}.")
    deadline = time.monotonic() + ESTIMATE_SECONDS
    meal = phone.read()
    while meal.get("status") not in FINAL and time.monotonic() < deadline:
        began = time.monotonic()
        meal = document(phone.call("GET", f"/v1/meals/{phone.meal}", params={"wait": WAIT_SECONDS}))
        time.sleep(max(0.0, 1.0 - (time.monotonic() - began)))
    if meal.get("status") not in FINAL:
        return failed(
            f"After {ESTIMATE_SECONDS:g} s the meal is {meal.get('status')}: is there a worker?"
        )
    return passed(f"The meal is {meal['status']}.")


def check_conditional_reading(phone: TrialPhone) -> Verdict:
    """A meal has an ETag, by which it is not sent twice."""
    path = f"/v1/meals/{phone.meal}"
    etag = phone.call("GET", path).headers.get("etag")
    if etag is None:
        return failed("GET of a meal has no ETag.")
    status = phone.call("GET", path, headers={"If-None-Match": etag}).status_code
    return (
        passed("304 for the version at hand.")
        if status == 304
        else failed(f"If-None-Match: {status}, not 304.")
    )


def check_changes(phone: TrialPhone) -> Verdict:
    """A change needs the version that it was made from, and counts once."""
    event = {"id": str(uuid.uuid4()), "kind": "comment", "text": "conformance"}
    answer = phone.send_event(event, None)
    call = "An event without If-Match"
    if failure := _unless_refused(answer, 428, "precondition_required", call):
        return failure
    answer = phone.send_event(event, '"0"')
    call = "An event with an old version"
    if failure := _unless_refused(answer, 412, "precondition_failed", call):
        return failure
    etag = phone.call("GET", f"/v1/meals/{phone.meal}").headers.get("etag")
    answers = [phone.send_event(event, etag) for _ in range(2)]
    if [answer.status_code for answer in answers] not in ([200, 200], [201, 200]):
        return failed(
            f"An event twice: {', '.join(str(answer.status_code) for answer in answers)}; expected 200, 200."
        )
    if document(answers[0]).get("version") != document(answers[1]).get("version"):
        return failed("The same event counted twice.")
    return passed("428, 412, and an event that is sent twice counts once.")


def check_pieces(phone: TrialPhone) -> Verdict:
    """A photograph in pieces continues where it broke off (tus 1.0)."""
    features = document(phone.client.get("/v1/server")).get("features", ())
    if "resumable_uploads" not in features:
        return not_seen("The server does not offer `resumable_uploads`.")
    meal, content, tus = str(uuid.uuid4()), phone.pair["left"], {"Tus-Resumable": "1.0.0"}
    phone.put_meal(meal)
    path, half = f"/v1/meals/{meal}/images/left/upload", len(content) // 2
    created = phone.call("POST", path, headers=tus | {"Upload-Length": str(len(content))})
    if created.status_code != 201:
        return failed(f"POST {path}: {created.status_code}.")
    pieces = {"Content-Type": "application/offset+octet-stream"} | tus
    phone.call("PATCH", path, content=content[:half], headers=pieces | {"Upload-Offset": "0"})
    offset = phone.call("HEAD", path, headers=tus).headers.get("upload-offset")
    if offset != str(half):
        return failed(f"After {half} bytes Upload-Offset is {offset}.")
    last = phone.call(
        "PATCH", path, content=content[half:], headers=pieces | {"Upload-Offset": offset}
    )
    image = document(phone.call("GET", f"/v1/meals/{meal}")).get("images", {}).get("left", {})
    if last.status_code != 204 or image.get("received_sha256") != digest(content):
        return failed(
            f"The last piece: {last.status_code}; the photograph arrived as {image.get('received_sha256')}."
        )
    return passed("It continued at its half.")


def check_deletion(phone: TrialPhone) -> Verdict:
    """A deleted meal leaves a receipt, and its id is gone for good."""
    path = f"/v1/meals/{phone.meal}"
    answer = phone.call("DELETE", path)
    receipt = document(answer).get("id")
    if answer.status_code != 200 or phone.client.get(f"/v1/receipts/{receipt}").status_code != 200:
        return failed(f"DELETE {path}: {answer.status_code}, receipt {receipt}.")
    if phone.call("GET", path).status_code not in {404, 410}:
        return failed("A deleted meal can still be read.")
    answer = phone.put_meal(phone.meal)
    failure = _unless_refused(answer, 410, "meal_deleted", "The deleted meal again")
    return failure or passed("Its receipt stays, its id is gone.")


def check_withdrawal(phone: TrialPhone) -> Verdict:
    """A withdrawal returns a receipt, and every later call is refused with `withdrawn`."""
    answer = phone.call("POST", "/v1/me/withdrawal")
    if answer.status_code != 200 or "id" not in document(answer):
        return failed(f"POST /v1/me/withdrawal: {answer.status_code}.")
    answer = phone.call("GET", "/v1/me")
    failure = _unless_refused(answer, 410, "withdrawn", "A call after leaving")
    return failure or passed("A receipt, and 410 `withdrawn` ever after.")


CHECKS: Mapping[Callable[[TrialPhone], Verdict], str] = {
    check_problems: "Refusals are problem documents",
    check_lost_answer: "A request whose answer was lost can be sent again",
    check_ids: "An id belongs to one meal",
    check_broken_upload: "A broken upload leaves nothing; a whole one is durable",
    check_repeated_photograph: "The same photograph again is harmless",
    check_unknown_fields: "Unknown fields of metadata are kept aside",
    check_time_zones: "Times fit their zones",
    check_whole_meal: "A meal in one request, twice, is one meal",
    check_estimate: "A pair is measured",
    check_conditional_reading: "Reading by ETag",
    check_changes: "Changes by If-Match, once each",
    check_pieces: "A photograph in pieces",
    check_deletion: "A deleted meal is gone",
    check_withdrawal: "After a withdrawal every call is refused",
}
ADVICE = frozenset({check_pieces})  # all others are required


def try_server(phone: TrialPhone) -> list[Result]:
    """Make all checks, one after the other. A check fails if there is no answer, or one of another form."""
    results = []
    for check, title in CHECKS.items():
        try:
            verdict = check(phone)
        except (httpx2.HTTPError, OSError) as error:
            verdict = failed(f"No answer: {type(error).__name__} {error}.")
        except MALFORMED as error:
            verdict = failed(
                f"An answer does not have the form that the API documents: {type(error).__name__} {error}."
            )
        results.append(Result(name_of(check), title, verdict, is_required=check not in ADVICE))
    return results


def _unless_refused(answer: httpx2.Response, status: int, code: str, call: str) -> Verdict | None:
    """Return the failure of a call that was not refused with this status and code; None if it was."""
    problem = document(answer)
    if answer.status_code != status or problem.get("code") != code:
        given = f"{answer.status_code} {problem.get('code', '')}"
        return failed(f"{call}: {given}, expected {status} {code}.")
    is_problem = answer.headers.get("content-type", "").startswith(PROBLEM_JSON)
    if not is_problem or "retryable" not in problem:
        return failed(f"{call}: {status} {code} without {PROBLEM_JSON} or `retryable`.")
    return None
