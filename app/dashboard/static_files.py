"""Scripts, styles and pictures of the pages. They are public: they hold no data."""

from urllib.parse import urlsplit

from starlette.responses import Response
from starlette.types import Scope

from app.dashboard.templates import STATIC, static
from app.http.public_files import PublicFiles

FOR_GOOD = "public, max-age=31536000, immutable"  # of an address that changes with its file (templates.static)
ASK_FIRST = "no-cache"


class DashboardFiles(PublicFiles):
    """Serves static/; a browser may keep a file for good if its address names this version of it."""

    def __init__(self) -> None:
        super().__init__(directory=STATIC)

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a file with its Cache-Control header.

        During an upgrade a page of one version may request files from a server of the other version. Such a file must
        not be cached for good under the page's address.
        """
        answer: Response = await super().get_response(path, scope)
        is_of_this_version = scope["query_string"].decode("latin-1") == urlsplit(static(path)).query
        answer.headers["Cache-Control"] = FOR_GOOD if is_of_this_version else ASK_FIRST
        return answer
