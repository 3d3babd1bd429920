"""The participants' phones, and what is printed for them: sheets of enrolment codes, and the marker as a PDF."""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Query
from markupsafe import Markup
from starlette.responses import Response

from app.core.errors import InvalidInputError, NotFoundError
from app.dashboard.forms import Fields, form_values
from app.dashboard.page import CurrentPage, Page, drawn_qr
from app.http.paging import Cursor
from app.messages.catalogue import catalogue
from app.people import devices, participants
from app.people.access.page_rules import PREFIX, server_address, study_address
from app.people.devices import capture_link, enrolment_text, issue_enrolment_code
from app.vision.marker_spec import DEFAULT_MARKER, FORMS, USUAL, parse_marker

router = APIRouter(include_in_schema=False)

PATH = f"{PREFIX}/studies/{{study}}/devices"
ENROL = f"{PREFIX}/studies/{{study}}/enrol"
DEVICES_A_PAGE = 100
MOST_CARDS = 60  # a sheet

Marker = Annotated[str, Query(max_length=64)]


@dataclass(frozen=True, slots=True)
class Card:
    """The card that a participant receives.

    link: enrols a browser in the capture page. browser_svg: its QR code. app_svg: that of the
    study's app; None: it has none.
    """

    participant: str
    code: str
    expires_at: datetime
    link: str
    app_svg: Markup | None
    browser_svg: Markup


@router.get(PATH)
def get_devices(
    page: CurrentPage,
    study: str,
    participant: Annotated[str | None, Query(max_length=64)] = None,
    cursor: Cursor = None,
) -> Response:
    """The phones, the most recently enrolled first."""
    phones = devices.list_devices(
        page.database, study, participant or None, cursor=cursor, limit=DEVICES_A_PAGE
    )
    return page.render(
        "devices.html", rows=phones.rows, next=phones.cursor, participant=participant or ""
    )


@router.post(f"{PATH}/{{device_id}}/revocation")
def post_revocation(page: CurrentPage, study: str, device_id: uuid.UUID) -> Response:
    """Revoke a phone's token, for example of a lost phone."""
    devices.revoke_device(page.database, page.caller, study, device_id)
    return page.redirect(
        study_address(study, "devices"), "The phone's token was revoked. Its uploads are kept."
    )


@router.get(ENROL)
def get_enrol(
    page: CurrentPage, participant: Annotated[Sequence[str], Query(max_length=500)] = ()
) -> Response:
    """The form that asks for participants' codes."""
    codes = " ".join(participant)
    return page.render("enrol.html", cards=[], refused=[], codes=codes, has_app=False)


@router.post(ENROL)
def post_enrol(page: CurrentPage, study: str, fields: Fields) -> Response:
    """A sheet with one card per participant, shown once; their earlier unused codes become invalid.

    A code that cannot get a card refuses the whole list: new codes would end those of cards that
    are printed already.
    """
    values = form_values(fields)
    entered, has_app = values.get("participants", ""), "app" in values
    codes = list(dict.fromkeys(entered.replace(",", " ").replace(";", " ").split()))
    if not codes or len(codes) > MOST_CARDS:
        raise InvalidInputError(f"Name one to {MOST_CARDS} participants.")
    wrong_codes = [(code, wrong) for code in codes if (wrong := _why_no_card(page, study, code))]
    if wrong_codes:
        return page.render(
            "enrol.html", status=422, cards=[], refused=wrong_codes, codes=entered, has_app=has_app
        )
    server = server_address(page.request, page.state.settings)
    cards = []
    for code in codes:
        issued = issue_enrolment_code(
            page.database, study_code=study, participant_code=code, caller=page.caller
        )
        link = capture_link(server, issued.code)
        app_svg = drawn_qr(enrolment_text(server, issued.code)) if has_app else None
        cards.append(Card(code, issued.code, issued.expires_at, link, app_svg, drawn_qr(link)))
    locale = page.require_study().locale
    words = {code: sentences[locale] for code, sentences in catalogue("cards").items()}
    return page.render(
        "enrol.html", cards=cards, refused=[], codes=entered, locale=locale, words=words
    )


def _why_no_card(page: Page, study: str, code: str) -> str | None:
    try:
        participant = participants.read_participant(page.database, study, code)
    except NotFoundError as error:
        return error.message
    return "This participant has left the study." if participant.withdrawn_at is not None else None


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
