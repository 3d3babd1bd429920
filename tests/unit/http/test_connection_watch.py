import asyncio

import pytest

from app.http import connection_protocol as http_protocol
from app.http.connection_protocol import ConnectionLimits, ConnectionWatch
from app.http.rate_limit import home_of
from tests.support.waiting import PATIENCE_SECONDS

LIMITS = ConnectionLimits(
    header_seconds=1.0,
    stall_seconds=1.0,
    connections=100,
    connections_per_address=2,
    proxies=["10.0.0.5", "fd00:1::/64"],
)


class Transport:
    def __init__(self):
        self.is_aborted = False

    def abort(self):
        self.is_aborted = True


class Connection:
    """What the watch sees of a protocol."""

    def __init__(self, loop, address="127.0.0.1", error=None):
        self.loop, self.client, self.transport = loop, (address, 1), Transport()
        self.looks, self.looked_at_often, self._error = 0, asyncio.Event(), error

    def look(self, now):
        self.looks += 1
        if self.looks >= 3:
            self.looked_at_often.set()
        if self._error is not None:
            raise self._error


async def codes_of_three(address):
    watch, loop = ConnectionWatch(LIMITS), asyncio.get_running_loop()
    connections = [Connection(loop, address) for _ in range(3)]
    found = [watch.admit(connection, home_of(address)) for connection in connections]
    for connection in connections:
        watch.forget(connection)
    return [error.code if error is not None else None for error in found]


@pytest.mark.parametrize(
    ("address", "third"),
    [(address, "rate_limited") for address in ("10.0.0.6", "fd00:2::5", "::ffff:10.0.0.6")]
    + [(proxy, None) for proxy in ("10.0.0.5", "fd00:1::5", "::ffff:10.0.0.5")],  # have no limit of their own
)
def test_third_connection_of_an_address_is_refused_but_of_a_trusted_proxy(address, third):
    assert asyncio.run(codes_of_three(address)) == [None, None, third]


def test_watch_goes_on_after_a_connection_that_cannot_be_looked_at(monkeypatch):
    monkeypatch.setattr(http_protocol, "TICK_SECONDS", 0.01)

    async def look_three_times():
        watch, loop = ConnectionWatch(LIMITS), asyncio.get_running_loop()
        broken, fine = Connection(loop, error=OSError("gone")), Connection(loop)
        for connection in (broken, fine):
            watch.admit(connection, "127.0.0.1")
        async with asyncio.timeout(PATIENCE_SECONDS):
            await fine.looked_at_often.wait()
        for connection in (broken, fine):
            watch.forget(connection)
        return broken.transport.is_aborted, fine.transport.is_aborted

    assert asyncio.run(look_three_times()) == (True, False)
