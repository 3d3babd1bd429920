"""Answers that end early: what a stream holds open is given back."""

import anyio
import pytest

from app.http.ranges import ClosingStream


class Source:
    """Bytes, and whether they were given back."""

    def __init__(self, pieces=3, fault=None):
        self.closed = 0
        self._pieces, self._fault = pieces, fault

    def __iter__(self):
        yield from [b"piece"] * self._pieces
        if self._fault is not None:
            raise self._fault

    def close(self):
        self.closed += 1


def answer(source, receive, send):
    async def run():
        stream = ClosingStream(iter(source), source.close, media_type="application/zip", headers={})
        await stream({"type": "http"}, receive, send)

    anyio.run(run)


async def stays():
    await anyio.sleep_forever()


async def hangs_up():
    return {"type": "http.disconnect"}


async def takes(_message):
    pass


async def takes_no_more(message):
    if message["type"] == "http.response.body":
        await anyio.sleep_forever()


def test_source_is_closed_once_when_it_was_read_to_its_end_the_caller_hung_up_or_it_failed():
    source = Source()
    answer(source, stays, takes)
    assert source.closed == 1
    for send in (takes, takes_no_more):
        source = Source(pieces=10_000)
        answer(source, hangs_up, send)
        assert source.closed == 1
    source = Source(fault=OSError("the disk"))
    with pytest.raises(OSError, match="the disk"):
        answer(source, stays, takes)
    assert source.closed == 1
