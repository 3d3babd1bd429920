import hashlib
import os
import tracemalloc

import anyio
import httpx2
import pytest
from fastapi import FastAPI, Request

from app.http.problems import install_problem_handlers
from app.http.upload import UploadLimits, received_body, received_parts
from app.photos.slots import PAIR_SLOTS

LIMITS = UploadLimits(photo_bytes=200_000, metadata_bytes=1000)
BOUNDARY = "b0undary"
HEADERS = {"content-type": f"multipart/form-data; boundary={BOUNDARY}"}


@pytest.fixture
def client(tmp_path):
    return client_for(tmp_path, LIMITS)


def client_for(folder, limits):
    app = FastAPI()
    install_problem_handlers(app)
    limiter = anyio.CapacityLimiter(2)

    @app.post("/parts")
    async def parts(request: Request):
        async with received_parts(request, PAIR_SLOTS, folder, limits, limiter) as found:
            return {
                "metadata": (found.metadata or b"").decode(),
                "files": {
                    slot: [file.sha256, file.bytes, file.path.stat().st_size] for slot, file in found.files.items()
                },
            }

    @app.put("/left")
    async def body(request: Request):
        async with received_body(request, "left", folder, limits, limiter) as file:
            return {"sha256": file.sha256, "bytes": file.bytes}

    return httpx2.AsyncClient(transport=httpx2.ASGITransport(app, raise_app_exceptions=False), base_url="http://test")


def part(name, content, content_type="image/jpeg", extra=""):
    head = f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="{name}"; filename="x"\r\n'
    head += f"Content-Type: {content_type}\r\n{extra}\r\n"
    return head.encode() + content + b"\r\n"


END = f"--{BOUNDARY}--\r\n".encode()


async def post(client, *parts, end=END, headers=HEADERS):
    return await client.post("/parts", content=b"".join(parts) + end, headers=headers)


def run(test, *args):
    return anyio.run(test, *args)


def test_parts_arrive_whole_with_their_hashes_and_files_are_gone_afterwards(client, tmp_path):
    left, right = os.urandom(150_000), os.urandom(10)
    answer = run(post, client, part("metadata", b"{}", "application/json"), part("left", left), part("right", right))
    assert answer.json() == {
        "metadata": "{}",
        "files": {
            "left": [hashlib.sha256(left).hexdigest(), 150_000, 150_000],
            "right": [hashlib.sha256(right).hexdigest(), 10, 10],
        },
    }
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("parts", "end", "status", "code"),
    [
        ([part("left", b"x" * 200_001)], END, 413, "image_too_large"),
        ([part("metadata", b"x" * 1001, "application/json")], END, 413, "metadata_too_large"),
        ([part("middle", b"x")], END, 400, "part_unknown"),
        ([part("left", b"x"), part("left", b"x")], END, 400, "part_repeated"),
        ([part("left", b"x", "text/html")], END, 415, "unsupported_media_type"),
        ([part("left", b"x" * 100)], b"", 400, "body_incomplete"),
        ([b"no boundary at all"], END, 400, "malformed_request"),
        ([part("left", b"x", extra="X-A: " + "a" * 70_000 + "\r\n")], END, 400, "malformed_request"),
    ],
)
def test_bad_body_is_refused_with_its_code_and_leaves_no_file(client, tmp_path, parts, end, status, code):
    async def send():
        return await post(client, *parts, end=end)

    answer = run(send)
    told = answer.json()
    assert (answer.status_code, told["code"]) == (status, code)
    assert answer.headers["content-type"] == "application/problem+json"
    assert list(tmp_path.iterdir()) == []
    if code == "image_too_large":
        assert (told["limit_bytes"], told["slot"]) == (200_000, "left")


@pytest.mark.parametrize(
    ("content_type", "code"),
    [
        ("application/json", "unsupported_media_type"),
        ("multipart/form-data", "malformed_request"),
        ("multipart/form-data; boundary=", "malformed_request"),
        (f"multipart/form-data; boundary={'x' * 300}", "malformed_request"),
    ],
)
def test_request_without_multipart_boundary_is_refused(client, content_type, code):
    async def send():
        return await client.post("/parts", content=b"{}", headers={"content-type": content_type})

    assert run(send).json()["code"] == code


def test_connection_cut_in_the_middle_leaves_no_file(tmp_path):
    async def scenario():
        app = client_for(tmp_path, LIMITS)._transport.app
        messages = iter(
            [
                {"type": "http.request", "body": part("left", b"x" * 100_000)[:50_000], "more_body": True},
                {"type": "http.disconnect"},
            ]
        )

        async def receive():
            return next(messages)

        sent = []

        async def send(message):
            sent.append(message)

        scope = {
            "type": "http",
            "method": "POST",
            "path": "/parts",
            "headers": [(b"content-type", HEADERS["content-type"].encode())],
            "query_string": b"",
            "http_version": "1.1",
            "scheme": "http",
            "server": ("test", 80),
            "client": ("127.0.0.1", 1),
            "root_path": "",
            "asgi": {"version": "3.0"},
        }
        await app(scope, receive, send)

    run(scenario)
    assert list(tmp_path.iterdir()) == []


def test_memory_stays_bounded_while_a_large_photograph_streams(tmp_path):
    size, chunk = 40_000_000, 64 * 1024
    client = client_for(tmp_path, UploadLimits(photo_bytes=size + 1, metadata_bytes=1000))

    async def body():
        yield part("left", b"")[:-2]
        piece = b"x" * chunk
        for _ in range(size // chunk):
            yield piece
        yield b"\r\n" + END

    async def send():
        return await client.post("/parts", content=body(), headers=HEADERS)

    tracemalloc.start()
    answer = run(send)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert answer.json()["files"]["left"][1] == size // chunk * chunk
    assert peak < 12_000_000  # a few writes' worth, far below the 40 MB that came


def test_body_as_one_photograph_is_hashed_and_limited(client, tmp_path):
    async def put(content, content_type="image/png"):
        return await client.put("/left", content=content, headers={"content-type": content_type})

    content = os.urandom(1000)
    assert run(put, content).json() == {"sha256": hashlib.sha256(content).hexdigest(), "bytes": 1000}
    assert run(put, b"x" * 200_001).json()["code"] == "image_too_large"
    assert run(put, b"x", "text/plain").json()["code"] == "unsupported_media_type"
    assert list(tmp_path.iterdir()) == []
