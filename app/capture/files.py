"""Serve the capture page's files: public, since they hold no data.

The page works offline: its service worker keeps all files of one version. Which files those are is
not written down anywhere; the server lists them, and prepends the list to the worker's script, so
that the script changes with any file and browsers notice the new version. Before the script are
also the texts of notifications, which are shown without a network.
"""

import hashlib
import json
import os
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from starlette.responses import Response
from starlette.types import Scope

from app.core.shipped import shipped_folder
from app.http.ranges import PublicFiles

PATH = "/capture"
STATIC = Path(__file__).parent / "static"
SERVICE_WORKER = "service-worker.js"
OF_NOTIFICATIONS = re.compile("title|remind_.*")  # keys of texts
MODULE_NAME = re.compile(r"\w+\.js")
CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; media-src 'self' blob:; "
    "connect-src 'self'; worker-src 'self'; manifest-src 'self'; form-action 'none'; base-uri 'none'; "
    "frame-ancestors 'none'"
)
HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), geolocation=(), microphone=(self), payment=(), usb=()",
    # the service worker keeps files by version; without one, ask each time
    "Cache-Control": "no-cache",
}


class CaptureFiles(PublicFiles):
    """ASGI app for PATH: the page, its scripts, the TypeScript client that it uses as `client/`, the service worker."""

    def __init__(self) -> None:
        super().__init__(directory=STATIC, html=True)

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a file with the page's headers; the service worker with the list of files before it."""
        if path == SERVICE_WORKER:
            answer = Response(service_worker(), media_type="text/javascript")
        else:
            answer = await super().get_response(path, scope)
        answer.headers.update(HEADERS)
        return answer

    def lookup_path(self, path: str) -> tuple[str, os.stat_result | None]:
        """Look a file up in static/, or in the client's folder."""
        folder, _, name = path.partition("/")
        if folder != "client":
            return super().lookup_path(path)
        place = client_folder() / name
        return (
            (str(place), place.stat())
            if MODULE_NAME.fullmatch(name) and place.is_file()
            else ("", None)
        )


def client_folder() -> Path:
    """Return the folder of the TypeScript client's modules: of the wheel, or of the checkout."""
    return shipped_folder("_client", "clients/typescript/src")


@cache
def service_worker() -> bytes:
    """Return the service worker's script, with its files, their common version and its texts as `SHELL`."""
    files = {path.relative_to(STATIC).as_posix(): path for path in STATIC.rglob("*")}
    files |= {
        f"client/{path.relative_to(client_folder()).as_posix()}": path
        for path in client_folder().rglob("*.js")
    }
    kept = {
        name: path
        for name, path in sorted(files.items())
        if path.is_file()
        and name != SERVICE_WORKER
        and path.suffix != ".md"
        and path.name != "LICENSE"
    }
    script = (STATIC / SERVICE_WORKER).read_bytes()
    version = hashlib.sha256(script)
    for name, path in kept.items():
        version.update(name.encode() + b"\0" + path.read_bytes())
    names = ["" if name == "index.html" else name for name in kept]
    shell = json.dumps(
        {"version": version.hexdigest()[:16], "files": names, "texts": _notification_texts()}
    )
    return f"const SHELL = {shell};\n".encode() + script


def _notification_texts() -> dict[str, dict[str, str]]:
    """Return the texts of notifications by language and key."""
    texts = {
        path.stem: json.loads(path.read_bytes())
        for path in sorted((STATIC / "texts").glob("*.json"))
    }
    return {
        language: {key: text for key, text in by_key.items() if OF_NOTIFICATIONS.fullmatch(key)}
        for language, by_key in texts.items()
    }
