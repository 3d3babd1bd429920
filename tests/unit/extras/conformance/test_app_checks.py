"""Each check of an app: a bad app fails it, a good one passes it, and one that has shown nothing does neither."""

from dataclasses import replace

import pytest

from app.extras.conformance.app_checks import CHECKS, judge
from app.extras.conformance.conversation import Conversation, Exchange, SentPhotograph
from app.extras.conformance.verdict import is_conforming, name_of

A, B = "6f5c3a52-6d0e-4f7b-8a55-2f0a8de3c9b1", "0f7a1c52-6d0e-4f7b-8a55-2f0a8de3c9b2"
METADATA = {"captured_at": "2026-11-20T12:30:00+08:00", "time_zone": "Asia/Shanghai"}
LATE = 1000.0  # s: after any patience


def outcome(name, *exchanges):
    """The verdict of one check on a conversation, whose exchanges come a second apart unless they have a time."""
    timed = [
        replace(each, at=float(number), ended_at=number + 0.1) if each.at < 0 else each
        for number, each in enumerate(exchanges)
    ]
    conversation = Conversation("phone", tuple(timed), timed[-1].ended_at if timed else 0.0)
    return next(result.verdict.outcome for result in judge(conversation) if result.name == name)


def call(method, path, status=200, at=-1.0, **changes):
    return Exchange(at, at + 0.1, method, path, status, **changes)


def put_meal(meal=A, status=202, **changes):
    changes.setdefault("metadata", METADATA)
    return call("PUT", f"/v1/meals/{meal}", status, **changes)


def put_photo(slot="left", meal=A, status=202, digest=None, **changes):
    photograph = SentPhotograph(slot, digest or f"{slot} of {meal}", "image/jpeg", has_exif=True)
    changes.setdefault("photographs", (photograph,))
    return call("PUT", f"/v1/meals/{meal}/images/{slot}", status, **changes)


def piece(offset, status=204, **changes):
    return call("PATCH", f"/v1/meals/{A}/images/left/upload", status, upload_offset=offset, **changes)


def answer_of(durable=(), missing=()):
    return {"images": {slot: {"durable": True} for slot in durable}, "missing": list(missing)}


def whole_meal(meal=A, **metadata):
    return (
        put_meal(meal, metadata=METADATA | metadata),
        put_photo("left", meal, answer=answer_of(["left"], ["right"])),
        put_photo("right", meal, answer=answer_of(["left", "right"])),
    )


LATER = call("GET", "/v1/me", at=LATE)

BAD = {
    "ids: a new id for each try": ("ids", *whole_meal(A), put_meal(B), put_photo("left", B, digest=f"left of {A}")),
    "ids: an id for two meals": ("ids", *whole_meal(), put_meal(status=409, answer={"code": "meal_id_reused"})),
    "safe_resending: given up": ("safe_resending", put_meal(status=None, fault="lost_answer"), LATER),
    "safe_resending: changed": (
        "safe_resending",
        put_meal(status=None, fault="lost_answer"),
        put_meal(metadata=METADATA | {"app_version": "2"}),
    ),
    "resume: given up": ("resume", put_meal(), put_photo(status=None, fault="lost_request"), LATER),
    "resume: begins anew": ("resume", *whole_meal(), put_photo("left", answer=answer_of(["left", "right"]))),
    "durable: dropped": ("durable", put_meal(), put_photo(fault="not_durable", answer=answer_of((), ["left"])), LATER),
    "durable: other bytes": ("durable", put_photo(fault="not_durable"), put_photo(digest="other")),
    "durable: pieces dropped": ("durable", piece(0, status=404, fault="not_durable"), piece(50, status=404), LATER),
    "etags: without If-Match": ("etags", call("POST", f"/v1/meals/{A}/events", 428)),
    "etags: a day without If-Match": ("etags", call("PUT", "/v1/me/days/2026-11-20", 428)),
    "etags: the refused version again": (
        "etags",
        call("POST", f"/v1/meals/{A}/events", 412, if_match='"3"', fault="stale"),
        call("POST", f"/v1/meals/{A}/events", 412, if_match='"3"'),
    ),
    "etags: given up": ("etags", call("POST", f"/v1/meals/{A}/events", 412, if_match='"3"', fault="stale"), LATER),
    "retry_after: too early": ("retry_after", put_photo(status=503, retry_after=3.0, at=0.0), put_photo(at=1.5)),
    "retry_after: given up": ("retry_after", put_photo(status=429, retry_after=2.0, at=0.0), LATER),
    "unknown_fields: does not go on": ("unknown_fields", *[put_meal() for _ in range(5)]),
    "both_photographs: one file twice": (
        "both_photographs",
        put_meal(),
        put_photo("left", digest="same"),
        put_photo("right", digest="same", answer=answer_of(["left", "right"])),
    ),
    "both_photographs: one only": ("both_photographs", put_meal(), put_photo("left"), LATER),
    "time_zones: time of sending": (
        "time_zones",
        put_meal(),
        put_meal(metadata=METADATA | {"captured_at": "2026-11-20T12:31:00+08:00"}),
    ),
    "time_zones: of the account": ("time_zones", put_meal(metadata=METADATA | {"time_zone": "Europe/Vienna"})),
    "time_zones: no name": ("time_zones", put_meal(metadata=METADATA | {"time_zone": "CST+8"})),
    "time_zones: no offset": ("time_zones", put_meal(metadata=METADATA | {"captured_at": "2026-11-20T12:30:00"})),
    "time_zones: no time": ("time_zones", put_meal(metadata=METADATA | {"captured_at": "noon"})),
    "tokens: in an address": ("tokens", call("GET", "/v1/me", has_secret_in_url=True)),
    "erasure: sent again": ("erasure", *whole_meal(), call("DELETE", f"/v1/meals/{A}", at=10.0), put_meal(at=15.0)),
    "erasure: sent again after 410": (
        "erasure",
        put_meal(status=410, answer={"code": "meal_deleted"}, at=0.0),
        put_photo(status=410, answer={"code": "meal_deleted"}, at=9.0),
    ),
    "erasure: calls after leaving": (
        "erasure",
        call("POST", "/v1/me/withdrawal", at=0.0),
        call("GET", "/v1/meals", 410, answer={"code": "withdrawn"}, at=9.0),
        call("GET", "/v1/meals", 410, answer={"code": "withdrawn"}, at=19.0),
    ),
    "exif: a picture without": (
        "exif",
        put_photo(photographs=(SentPhotograph("left", "x", "image/jpeg", has_exif=False),)),
    ),
    "exif: another format": ("exif", put_photo(photographs=(SentPhotograph("left", "x", "image/png", has_exif=True),))),
}
CHANGE = f"/v1/meals/{A}/events"
GOOD = (
    put_meal(status=None, fault="lost_answer", at=0.0),
    put_meal(at=1.0),
    put_photo("left", status=None, fault="lost_request", photographs=(), at=2.0),
    put_photo("left", answer=answer_of(["left"], ["right"]), at=3.0),
    put_photo("right", status=503, retry_after=3.0, fault="unavailable", at=4.0),
    put_photo("right", answer=answer_of(["left", "right"]), at=7.2),
    put_meal(B, status=429, retry_after=2.0, fault="rate_limited", at=8.0),
    put_meal(B, at=10.2),
    put_photo("left", B, fault="not_durable", answer=answer_of((), ["left", "right"]), at=11.0),
    put_photo("right", B, answer=answer_of(["right"], ["left"]), at=12.0),
    put_photo("left", B, answer=answer_of(["left", "right"]), at=13.0),
    call("GET", f"/v1/meals/{A}", at=20.0),
    call("POST", CHANGE, 412, if_match='"3"', fault="stale", at=21.0),
    call("GET", f"/v1/meals/{A}", at=22.0),
    call("POST", CHANGE, if_match='"3"', at=23.0),
    call("DELETE", f"/v1/meals/{B}", at=30.0),
    call("GET", f"/v1/meals/{A}", at=LATE),
)


@pytest.mark.parametrize("bad", BAD)
def test_bad_app_fails(bad):
    assert outcome(*BAD[bad]) == "failed"


@pytest.mark.parametrize("name", [name_of(check) for check in CHECKS])
def test_app_that_does_all_that_is_asked_passes_each_check_and_one_that_has_shown_nothing_has_not(name):
    assert outcome(name, *GOOD) == "passed"
    assert outcome(name, call("GET", "/v1/me")) == "not_seen"
    assert name in {checked for checked, *_ in BAD.values()}


@pytest.mark.parametrize(
    ("name", "exchanges"),
    [
        ("safe_resending", (put_meal(status=None, fault="lost_answer"),)),
        ("resume", (put_photo(status=None, fault="lost_request"),)),
        ("durable", (put_photo(fault="not_durable"), put_photo("right"))),
        ("etags", (call("POST", CHANGE, 412, if_match='"3"', fault="stale"),)),
        ("retry_after", (put_photo(status=503, retry_after=3.0),)),
        ("both_photographs", (put_meal(), put_photo("left"))),
    ],
)
def test_app_that_may_still_do_it_has_neither_passed_nor_failed(name, exchanges):
    assert outcome(name, *exchanges) == "not_seen"


def test_meal_in_one_request_is_judged_like_its_parts():
    photographs = tuple(SentPhotograph(slot, slot, "image/jpeg", has_exif=True) for slot in ("left", "right"))
    sent = call("POST", "/v1/meals", 202, metadata=METADATA | {"id": A.upper()}, photographs=photographs)
    lost = replace(sent, status=None, fault="lost_answer")
    again = replace(sent, answer=answer_of(["left", "right"]))
    assert outcome("safe_resending", lost, again) == outcome("both_photographs", lost, again) == "passed"
    accepted = replace(sent, fault="not_durable", answer=answer_of((), ["left", "right"]))
    assert outcome("durable", accepted, again) == "passed"
    assert outcome("durable", accepted, LATER) == "failed"
    assert outcome("resume", again, again) == "not_seen"  # the whole meal again is allowed


def test_photograph_in_pieces_begins_again_once_the_server_has_lost_them():
    lost, begun = piece(100, status=404, fault="not_durable"), call("POST", f"/v1/meals/{A}/images/left/upload", 201)
    assert outcome("durable", piece(0), lost, begun, piece(0), piece(100)) == "passed"
    assert outcome("durable", piece(0), lost, put_photo()) == "passed"  # whole
    assert outcome("durable", piece(0), lost, begun) == "not_seen"
    broken = piece(0, status=None, fault="lost_request")
    assert outcome("resume", broken, piece(40)) == "passed"
    assert outcome("resume", broken, begun) == "not_seen"


def test_clock_in_utc_fits_any_zone_and_advice_alone_does_not_fail_an_app():
    assert outcome("time_zones", put_meal(metadata=METADATA | {"captured_at": "2026-11-20T04:30:00Z"})) == "passed"
    without_exif = put_photo(
        "left", photographs=(SentPhotograph("left", "x", "image/jpeg", has_exif=False),), at=LATE + 1
    )
    results = judge(Conversation("phone", (*GOOD, without_exif), LATE + 2))
    assert [result.name for result in results if result.verdict.outcome == "failed"] == ["resume", "exif"]
    results = judge(Conversation("phone", GOOD, LATE))
    assert is_conforming(results)
    assert not is_conforming(judge(Conversation("phone", GOOD[:-2], LATE)))
