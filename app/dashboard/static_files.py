"""Scripts, styles and pictures of the pages, open to everybody: they say nothing of anybody."""

import os
from urllib.parse import urlsplit

from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from app.dashboard.templates import STATIC, static

FOR_GOOD = "public, max-age=31536000, immutable"  # of an address that changes with its file (templates.static)
ASK_FIRST = "no-cache"


class DashboardFiles(StaticFiles):
    """The files of static/."""

    def __init__(self) -> None:
        super().__init__(directory=STATIC)

    async def get_response(self, path: str, scope: Scope) -> Response:
        """A file, with how long browsers may keep it.

        During an upgrade a page of the one version may ask a server of the other for its files: what that one has must
        not be kept for good under the page's address.
        """
        answer: Response = await super().get_response(path, scope)
        is_of_this_version = scope["query_string"].decode("latin-1") == urlsplit(static(path)).query
        answer.headers["Cache-Control"] = FOR_GOOD if is_of_this_version else ASK_FIRST
        return answer

    def lookup_path(self, path: str) -> tuple[str, os.stat_result | None]:
        """As StaticFiles; nothing that begins with a dot."""
        if any(part.startswith(".") for part in path.split("/")):
            return "", None
        return super().lookup_path(path)
