"""Items that two reviewers decide without seeing each other, one at a time, and how far they agree."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel
from starlette.responses import HTMLResponse, Response

from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.dashboard.forms import (
    EMPTY_FORM,
    Blank,
    Fields,
    FormState,
    form_values,
    read_form,
    refused,
    with_point,
)
from app.dashboard.meal_pages.review import outline_in
from app.dashboard.page import CurrentPage, Page, csv_file
from app.http.text_schemas import LocalDay
from app.people.access.page_rules import STUDY_PAGES, study_address
from app.records.double_review.decide import BlindReview
from app.records.double_review.queries import decided_by_two
from app.records.double_review.schemas import DecisionIn, DecisionOut
from app.records.double_review.study_agreement import known_agreement, study_agreement

router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/blind"


class Asked(BaseModel):
    """The address's parameters.

    skip: items to leave out; last: the reader's last decision, to be undone

    differing: items that two others decided differently
    """

    day: Annotated[LocalDay | None, Blank] = None
    differing: bool = False
    skip: list[uuid.UUID] = []
    last: uuid.UUID | None = None


AskedFor = Annotated[Asked, Query()]


@router.get(PATH)
def get_blind(page: CurrentPage, asked: AskedFor) -> HTMLResponse:
    """The reader's next item."""
    return _blind(page, asked)


@router.post(PATH)
def post_blind(page: CurrentPage, fields: Fields, asked: AskedFor) -> Response:
    """Decide an item."""
    values = form_values(fields)
    body = {"item": values.get("item", "")}
    if "reject" not in values:
        food = values.get("food") or values.get("q") or values.get("choice", "")
        body |= {"food": food, "mass_g": with_point(values.get("mass_g", ""))}
    try:
        decision = _review(page).decide(read_form(DecisionIn, body), differing=asked.differing)
    except (InvalidInputError, ConflictError, NotFoundError) as error:
        return _blind(page, asked, refused(error, values))
    return page.redirect(page.address(last=decision.id))


@router.post(PATH + "/{decision}/undo")
def post_undo(page: CurrentPage, decision: uuid.UUID) -> Response:
    """Take the reader's decision back."""
    _review(page).undo(decision)
    return page.redirect(study_address(page.study_code, "blind"), "Undone.")


@router.get(PATH + "/{item}/picture")
def get_picture(page: CurrentPage, item: uuid.UUID, width: int = 1600) -> Response:
    """An item's picture."""
    headers = {"Cache-Control": "private, no-store"}
    return Response(_review(page).picture(item, width), media_type="image/jpeg", headers=headers)


@router.get(STUDY_PAGES + "/agreement")
def get_agreement(
    page: CurrentPage, output: Annotated[str, Query(alias="format", max_length=8)] = ""
) -> Response:
    """How far the reviewers agree; as CSV their decisions. Owners see the known items' results, too."""
    study = page.require_study()
    with page.database.read() as session:
        if output == "csv":
            rows = [made for item in decided_by_two(session, study.id) for made in item]
            return csv_file(DecisionOut, rows, f"decisions-of-{study.code}")
        answers = known_agreement(session, study.id) if page.may("owner") else []
        return page.render("agreement.html", rows=study_agreement(session, study.id), known=answers)


def _review(page: Page) -> BlindReview:
    return BlindReview(page.state, page.study_caller, page.require_study())


def _blind(page: Page, asked: Asked, form: FormState = EMPTY_FORM) -> HTMLResponse:
    item = _review(page).next_item(asked.day, asked.skip, differing=asked.differing)
    outline = None
    if item is not None and item.size_px is not None:
        outline = outline_in(*item.size_px, item.rings)
    return page.render("blind.html", form=form, item=item, outline=outline, asked=asked)
