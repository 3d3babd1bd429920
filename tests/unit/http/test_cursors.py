"""Cursors: what is written is read again, in one way only."""

import uuid
from datetime import UTC, date, datetime, timedelta, timezone

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.errors import InvalidInputError
from app.http.paging import DAY, ID, INSTANT, NUMBER, TEXT, WHOLE_NUMBER, decode_cursor, encode_cursor

INSTANTS = st.datetimes(datetime(2, 1, 1), datetime(9998, 1, 1), timezones=st.just(UTC))  # noqa: DTZ001
FLOATS = st.floats(allow_nan=False, allow_infinity=False)
TEXTS = st.text(st.characters(blacklist_characters="\0", blacklist_categories=["Cs"]))


@given(INSTANTS, st.uuids(), st.dates(), st.integers(0, 2**63 - 1), FLOATS, TEXTS)
def test_key_is_read_as_it_was_written(instant, row, day, count, number, text):
    there = instant.astimezone(timezone(timedelta(hours=8)))
    assert decode_cursor("l", encode_cursor("l", there, row), INSTANT, ID) == (instant, row)
    assert decode_cursor("l", encode_cursor("l", day, row), DAY, ID) == (day, row)
    kept = encode_cursor("l", count, "kind", "row")
    assert decode_cursor("l", kept, WHOLE_NUMBER, TEXT, TEXT) == (count, "kind", "row")
    assert decode_cursor("l", encode_cursor("l", number), NUMBER) == number
    assert decode_cursor("l", encode_cursor("l", text), TEXT) == text


@pytest.mark.parametrize(
    ("part", "text"),
    [
        (WHOLE_NUMBER, "-1"),
        (WHOLE_NUMBER, "1_0"),
        (WHOLE_NUMBER, str(2**63)),
        (NUMBER, "nan"),
        (NUMBER, "5e-1"),
        (INSTANT, "0001-01-01T00:00:00+23:59"),
        (INSTANT, "2026-11-20T12:00:00+08:00"),
        (DAY, "2026-02-30"),
        (ID, str(uuid.UUID(int=7))),
        (TEXT, "a\0b"),
    ],
)
def test_key_that_could_not_have_been_written_is_no_cursor(part, text):
    with pytest.raises(InvalidInputError) as caught:
        decode_cursor("l", encode_cursor("l", text), part)
    assert caught.value.code == "cursor_invalid"


def test_key_of_more_or_fewer_parts_or_of_another_list_is_no_cursor_and_without_one_the_list_begins():
    for key in ("", "2026-11-20", f"2026-11-20 {'0' * 32} more"):
        with pytest.raises(InvalidInputError, match="broken"):
            decode_cursor("l", encode_cursor("l", key), DAY, ID)
    with pytest.raises(InvalidInputError) as caught:
        decode_cursor("l", encode_cursor("m", date(2026, 11, 20)), DAY)
    assert caught.value.code == "cursor_of_other_filters"
    assert decode_cursor("l", None, TEXT) is None


def test_cursor_of_changes_that_was_kept_over_an_upgrade_still_leads_on():
    kept = "WyIxMiByZWNvcmQgMDAwMDAwMDAtMDAwMC0wMDAwLTAwMDAtMDAwMDAwMDAwMDA3IiwgIjNlYzYxYjJmZmU5YmM5OTMiXQ"
    row = str(uuid.UUID(int=7))
    assert encode_cursor("changes of pilot", 12, "record", row) == kept
    assert decode_cursor("changes of pilot", kept, WHOLE_NUMBER, TEXT, TEXT) == (12, "record", row)
