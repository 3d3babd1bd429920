"""Scripts, styles and pictures of the pages, open to everybody: they say nothing of anybody."""

from typing import Any

from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from app.dashboard.templates import STATIC

FOR_GOOD = "public, max-age=31536000, immutable"  # of an address that changes with its file (templates.static)
ASK_FIRST = "no-cache"


class DashboardFiles(StaticFiles):
    """The files of static/."""

    def __init__(self) -> None:
        super().__init__(directory=STATIC)

    async def get_response(self, path: str, scope: Scope) -> Response:
        """A file, with how long browsers may keep it."""
        answer: Response = await super().get_response(path, scope)
        has_version = b"v=" in scope["query_string"]
        answer.headers["Cache-Control"] = FOR_GOOD if has_version else ASK_FIRST
        return answer

    def lookup_path(self, path: str) -> tuple[str, Any]:
        """As StaticFiles; nothing that begins with a dot."""
        if any(part.startswith(".") for part in path.split("/")):
            return "", None
        return super().lookup_path(path)
