"""Hold every answer that an integration test gets against the OpenAPI document: status, media type, headers."""

import re
from collections.abc import Callable, Mapping
from typing import Any

import httpx2

HEADERS = frozenset(
    {
        "accept-ranges", "content-disposition", "content-range", "deprecation", "etag", "link", "location",
        "ratelimit", "ratelimit-policy", "retry-after", "sunset", "www-authenticate",
    }
)  # fmt: skip
ALWAYS_SENT = frozenset(
    {"etag", "location"}
)  # where they are declared; the others depend on the settings and on the caller
# Of no operation: a method that the address lacks, a head that is too long, a fault of ours.
OF_ANY_ADDRESS = frozenset({405, 414, 431, 500})


def declared_answers(document: Mapping[str, Any]) -> Callable[[httpx2.Response], None]:
    """Return a hook for httpx2 that raises AssertionError where an answer is not what the document declares.

    Answers of addresses and methods that are no operation of the document pass.
    """
    patterns = [(_pattern(path), path) for path in sorted(document["paths"], key=lambda path: path.count("{"))]

    def require_declared(response: httpx2.Response) -> None:
        address, method = response.request.url.raw_path.partition(b"?")[0].decode(), response.request.method.lower()
        path = next((path for pattern, path in patterns if pattern.fullmatch(address)), None)
        if path is None or method not in document["paths"][path] or response.status_code in OF_ANY_ADDRESS:
            return
        answer = f"{method.upper()} {path}: {response.status_code}"
        declared = document["paths"][path][method]["responses"].get(str(response.status_code))
        assert declared is not None, f"{answer} is not declared"
        media_type = response.headers.get("content-type", "").partition(";")[0]
        assert not media_type or media_type in declared.get("content", {}), f"{answer} as {media_type} is not declared"
        names, sent = {name.lower() for name in declared.get("headers", {})}, set(response.headers.keys())
        assert (HEADERS & sent) <= names, f"{answer} with {(HEADERS & sent) - names} is not declared"
        assert (ALWAYS_SENT & names) <= sent, f"{answer} lacks {(ALWAYS_SENT & names) - sent}, which is declared"

    return require_declared


def _pattern(path: str) -> re.Pattern[str]:
    parts = re.split(r"(\{[^}]+\})", path)
    return re.compile("".join("[^/]+" if part.startswith("{") else re.escape(part) for part in parts))
