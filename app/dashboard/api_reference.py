"""/docs: the API's document to read and to try in a browser, with nothing asked of other hosts."""

from starlette.requests import Request
from starlette.responses import HTMLResponse

from app.dashboard.answers import HEADERS
from app.dashboard.templates import render

PATH = "/docs"


async def api_reference(_request: Request) -> HTMLResponse:
    """The page; it is open to everybody, as the document is: what the server can do is no secret."""
    return HTMLResponse(render("api_reference.html"), headers=dict(HEADERS) | {"Cache-Control": "no-cache"})
