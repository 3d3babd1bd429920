"""Common to all calls: the connection, the token, repeats, and downloads that continue where they broke off."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from email.utils import formatdate
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self, TypeVar
from urllib.parse import quote

import httpx2

from tada_client.errors import NetworkError, Problem
from tada_client.retries import RetryPolicy, retry_after_seconds

Scalar = str | int | float | bool | None
Filter = Scalar | Sequence[Scalar]  # a query parameter; None: left out
Query = Mapping[str, Filter]
Answer = TypeVar("Answer")

FIRST_ERROR, PARTIAL = 400, 206


class Caller:
    """One server and one token. Use it in a `with` block, or call `close`."""

    def __init__(
        self,
        server: str,
        token: str | None = None,
        *,
        seconds: float = 30.0,
        retries: RetryPolicy | None = None,
        app_version: str | None = None,
    ) -> None:
        """Raise ValueError if `server` is no address such as https://tada.example.org.

        seconds: the longest silence of the server within an attempt.
        """
        url = httpx2.URL(server)
        if (
            url.scheme not in {"http", "https"}
            or not url.host
            or url.userinfo
            or url.query
            or url.fragment
        ):
            raise ValueError(
                f"No address of a server, such as https://tada.example.org: {server!r}"
            )
        self.token = token
        self.seconds = seconds
        self.retries = retries or RetryPolicy()
        self._app_version = app_version
        # no redirects: the token goes to the named server only
        self._client = httpx2.Client(base_url=server, follow_redirects=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def call(
        self,
        method: str,
        path: str,
        *,
        query: Query | None = None,
        json: object = None,
        file: Path | bytes | None = None,
        files: Mapping[str, tuple[str, bytes, str]] | None = None,
        headers: Mapping[str, str] | None = None,
        seconds: float | None = None,
        attempts: int | None = None,
    ) -> Any:
        """Return the JSON of any call of the API; None without content (204, 304).

        file: the body, as it is; a path is read while it is sent. files: parts of a form, (file name, content, type).
        attempts: in place of the RetryPolicy's.
        Raises Problem or NetworkError.
        """

        def attempt() -> Any:
            with _body(file) as (content, of_body):
                asked = self._request(
                    method,
                    path,
                    query,
                    {**of_body, **(headers or {})},
                    seconds,
                    json=json,
                    content=content,
                    files=files,
                )
                with self._answer(asked) as response:
                    response.read()
                    try:
                        return response.json() if response.content else None
                    except ValueError as error:  # a page of the network's, such as its sign-in
                        raise NetworkError("The answer is not the server's.") from error

        return self._repeat(attempt, attempts)

    def numbers_in_headers(self, method: str, path: str, *names: str) -> tuple[int, ...]:
        """Return headers of the answer to a call without a body, each a whole number.

        Raises Problem; NetworkError also if one is missing or no number, as in the answer of a network's sign-in page.
        """

        def attempt() -> tuple[int, ...]:
            with self._answer(self._request(method, path, None, {}, None)) as response:
                values = [response.headers.get(name, "") for name in names]
            if not all(value.isascii() and value.isdigit() for value in values):
                raise NetworkError("The answer is not the server's.")
            return tuple(map(int, values))

        return self._repeat(attempt)

    def download(self, path: str, target: Path, *, query: Query | None = None) -> Path:
        """Write an answer to a file, which appears when it is whole. A broken download continues where the server can.

        Raises Problem, NetworkError or OSError.
        """
        part = target.with_name(target.name + ".part")
        etag = ""

        def attempt() -> None:
            nonlocal etag
            length = part.stat().st_size if etag and part.exists() else 0
            headers = {"Range": f"bytes={length}-", "If-Range": etag} if length else {}
            with self._answer(self._request("GET", path, query, headers, None)) as response:
                etag = (
                    response.headers.get("ETag", "") if "Accept-Ranges" in response.headers else ""
                )
                with part.open("ab" if response.status_code == PARTIAL else "wb") as file:
                    for piece in response.iter_bytes():
                        file.write(piece)

        self._repeat(attempt)
        return part.replace(target)

    def pages(self, path: str, query: Query) -> Iterator[Any]:
        """Yield the pages of a list, following `next`."""
        page = self.call("GET", path, query=query)
        while True:
            yield page
            if page["next"] is None:
                return
            page = self.call("GET", page["next"])

    def rows(self, path: str, query: Query) -> Iterator[Any]:
        """Yield the `items` of all pages of a list."""
        for page in self.pages(path, query):
            yield from page["items"]

    def _request(
        self,
        method: str,
        path: str,
        query: Query | None,
        headers: Mapping[str, str],
        seconds: float | None,
        **body: Any,
    ) -> httpx2.Request:
        own = {"Date": formatdate(usegmt=True)}  # the study learns the error of a phone's clock
        if self.token is not None:
            own["Authorization"] = f"Bearer {self.token}"
        if self._app_version is not None:
            own["X-App-Version"] = self._app_version
        params = (
            {name: value for name, value in query.items() if value is not None} if query else None
        )
        return self._client.build_request(
            method,
            path,
            params=params,
            headers=own | dict(headers),
            timeout=seconds or self.seconds,
            **body,
        )

    @contextmanager
    def _answer(self, request: httpx2.Request) -> Iterator[httpx2.Response]:
        """Send a request; the answer is open. Raises Problem or NetworkError, also while the answer is read."""
        try:
            response = self._client.send(request, stream=True)
            try:
                if response.status_code >= FIRST_ERROR or response.has_redirect_location:
                    response.read()
                    raise _problem(response)
                yield response
            finally:
                response.close()
        except (httpx2.TransportError, httpx2.DecodingError) as error:
            raise NetworkError(f"No whole answer came: {error}") from error

    def _repeat(self, attempt: Callable[[], Answer], attempts: int | None = None) -> Answer:
        policy = self.retries if attempts is None else replace(self.retries, attempts=attempts)
        number = 1
        while True:
            try:
                return attempt()
            except (Problem, NetworkError) as error:
                pause = policy.seconds_until_next(error, number)
                if pause is None:
                    raise
            time.sleep(pause)
            number += 1


def path_of(*segments: object) -> str:
    """Return an address of the API: each segment is one, whatever it contains.

    Raises ValueError for "", "." and "..".
    """
    texts = [str(segment) for segment in segments]
    if any(text in {"", ".", ".."} for text in texts):
        raise ValueError(f"No part of a path: {texts}")
    return "/v1/" + "/".join(quote(text, safe="") for text in texts)


@contextmanager
def _body(file: Path | bytes | None) -> Iterator[tuple[BinaryIO | bytes | None, dict[str, str]]]:
    """Return a body that is sent piece by piece, and its headers."""
    if file is None:
        yield None, {}
        return
    headers = {"Content-Type": "application/octet-stream"}
    if isinstance(file, bytes):
        yield file, headers
        return
    with file.open("rb") as content:
        yield content, headers | {"Content-Length": str(file.stat().st_size)}


def _problem(response: httpx2.Response) -> Problem:
    after = retry_after_seconds(response.headers)
    if not response.headers.get("Content-Type", "").startswith("application/problem+json"):
        return Problem(response.status_code, None, after)
    try:
        return Problem(response.status_code, response.json(), after)
    except ValueError:
        return Problem(response.status_code, None, after)
