"""What the server does with requests that do not come to their end."""

import asyncio
import json
from types import SimpleNamespace

from app.core.settings import Settings
from app.http.answers import Edge
from app.http.rate_limit import CallLimits


async def read_body(scope, receive, send):
    while (await receive())["more_body"]:
        pass
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"{}"})


async def nothing_more():
    await asyncio.Event().wait()


def part(more_body):
    return {"type": "http.request", "body": b"x" * 20_000, "more_body": more_body}


def answer_to(messages, stall_seconds, *, is_cancelled=False):
    """Status, headers and content of the answer to an upload whose body stops after these messages."""
    settings = Settings(stall_seconds=stall_seconds)
    limits = CallLimits(settings)
    state = SimpleNamespace(settings=settings, part=lambda _: limits)
    scope = {"type": "http", "method": "POST", "path": "/v1/meals", "query_string": b"", "headers": []}
    scope |= {"client": ("192.0.2.1", 1), "app": SimpleNamespace(state=SimpleNamespace(api=state))}
    waiting, sent = list(messages), []

    async def receive():
        return waiting.pop(0) if waiting else await nothing_more()

    async def send(message):
        sent.append(message)

    async def run():
        answering = asyncio.create_task(Edge(read_body, ())(scope, receive, send))
        if is_cancelled:
            await asyncio.sleep(0)
            answering.cancel()
        await answering

    asyncio.run(run())
    headers = {name.lower(): value for name, value in sent[0]["headers"]}
    return sent[0]["status"], headers, json.loads(sent[1]["body"])


def test_body_that_stalls_is_refused_and_its_connection_ends_and_a_whole_one_is_not():
    status, headers, problem = answer_to([part(True)], 0.01)
    assert (status, problem["code"], problem["retryable"]) == (408, "body_too_slow", True)
    assert headers[b"connection"] == b"close"
    assert answer_to([part(True), part(False)], 0.01)[0] == 200


def test_request_under_way_when_the_server_ends_is_told_to_come_again():
    status, headers, problem = answer_to([part(True)], 60.0, is_cancelled=True)
    assert (status, problem["code"], problem["retryable"]) == (503, "server_stops", True)
    assert headers[b"retry-after"] == b"5"
