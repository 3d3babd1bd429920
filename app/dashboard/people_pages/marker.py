"""The marker to print: chosen on a page, drawn as a PDF at true size."""

from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.dashboard.page import CurrentPage
from app.people.access.page_rules import PREFIX
from app.vision.marker_spec import DEFAULT_MARKER, FORMS, USUAL, parse_marker

router = APIRouter(include_in_schema=False)

Marker = Annotated[str, Query(max_length=64)]


@router.get(f"{PREFIX}/marker")
def get_marker(page: CurrentPage, marker: Marker = DEFAULT_MARKER) -> Response:
    """The choice of a marker, and what to check after printing."""
    return page.render("marker.html", marker=str(parse_marker(marker)), usual=USUAL, forms=FORMS)


@router.get(f"{PREFIX}/marker.pdf")
def get_marker_pdf(page: CurrentPage, marker: Marker) -> Response:
    """The marker as a PDF."""
    from app.people.print_marker import render_marker_pdf  # noqa: PLC0415  # the PDF writer is only loaded if used

    del page  # only requires a session
    spec = parse_marker(marker)
    name = str(spec).replace(":", "-").replace("=", "-")
    headers = {"Content-Disposition": f'attachment; filename="marker-{name}.pdf"'}
    return Response(render_marker_pdf(spec), media_type="application/pdf", headers=headers)
