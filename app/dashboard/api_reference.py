"""/docs: the OpenAPI document in Swagger UI, without requests to other hosts."""

from starlette.requests import Request
from starlette.responses import HTMLResponse

from app.dashboard.answers import HEADERS
from app.dashboard.templates import render

PATH = "/docs"


async def api_reference(_request: Request) -> HTMLResponse:
    """Return the page. It is public, as the document is."""
    return HTMLResponse(
        render("api_reference.html"), headers=dict(HEADERS) | {"Cache-Control": "no-cache"}
    )
