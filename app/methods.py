"""What a method means at every address: HEAD is GET without the body, and a 405 names all that the address takes."""

from starlette.datastructures import MutableHeaders
from starlette.routing import compile_path
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.people.access.access_rules import RULES

OF_FILES = "/dashboard/static/"  # answered by Starlette, which knows HEAD
NOT_ALLOWED = 405
OF_ROUTING = ("route", "endpoint", "path_params")  # what logs and limits read of a request once it is routed
ADDRESSES = {path: compile_path(path)[0] for _, path in RULES}


def allowed_methods(path: str) -> list[str]:
    """Those that an address takes; none where there is no such address."""
    taken = {method for method, pattern in RULES if ADDRESSES[pattern].match(path)}
    return sorted(taken | ({"HEAD"} if "GET" in taken else set()))


class Methods:
    """ASGI middleware, next to the routes."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a HEAD on as a GET and hold its body back; complete the `Allow` of a refused method."""
        if scope["type"] != "http" or scope["path"].startswith(OF_FILES):
            await self._app(scope, receive, send)
            return
        is_head = scope["method"] == "HEAD"
        scope.setdefault("state", {})  # shared with what stands around
        asked = {**scope, "method": "GET"} if is_head else scope  # routing writes into its own

        async def checked_send(message: Message) -> None:
            if message["type"] == "http.response.start":
                scope.update({name: asked[name] for name in OF_ROUTING if name in asked})
                if message["status"] == NOT_ALLOWED:
                    MutableHeaders(scope=message)["Allow"] = ", ".join(allowed_methods(scope["path"]))
            elif is_head and message["type"] == "http.response.body":
                message = {**message, "body": b""}
            await send(message)

        await self._app(asked, receive, checked_send)
