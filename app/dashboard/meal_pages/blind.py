"""Items that two reviewers decide without seeing each other, one at a time, and how far they agree."""

import uuid
from collections.abc import Sequence
from datetime import date
from typing import Annotated

from fastapi import APIRouter, Query
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
from app.people.access.page_rules import STUDY_PAGES
from app.records.double_review.api import render_decision
from app.records.double_review.decide import BlindReview
from app.records.double_review.schemas import DecisionIn, DecisionOut
from app.records.double_review.study_agreement import (
    decided_by_two,
    known_results,
    study_agreement,
)

router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/blind"
Skipped = Annotated[Sequence[uuid.UUID], Query(max_length=100)]
Day = Annotated[LocalDay | None, Blank]


@router.get(PATH)
def get_blind(
    page: CurrentPage,
    day: Day = None,
    skip: Skipped = (),
    last: uuid.UUID | None = None,
    *,
    differing: bool = False,
) -> HTMLResponse:
    """The reader's next item; last: their last decision, to be undone."""
    return _blind(page, day, skip, last, differing=differing)


@router.post(PATH)
def post_blind(
    page: CurrentPage,
    fields: Fields,
    day: Day = None,
    skip: Skipped = (),
    *,
    differing: bool = False,
) -> Response:
    """Decide an item."""
    values = form_values(fields)
    body = {"item": values.get("item", "")}
    if "reject" not in values:
        food = values.get("food") or values.get("q") or values.get("choice", "")
        body |= {"food": food, "mass_g": with_point(values.get("mass_g", ""))}
    try:
        decision = _review(page).decide(read_form(DecisionIn, body))
    except (InvalidInputError, ConflictError, NotFoundError) as error:
        return _blind(page, day, skip, None, refused(error), differing=differing)
    return page.redirect(page.address(last=decision.id))


@router.post(PATH + "/{decision}/undo")
def post_undo(page: CurrentPage, decision: uuid.UUID) -> Response:
    """Take the reader's decision back."""
    _review(page).undo(decision)
    return page.redirect(page.request.url.path.removesuffix(f"/{decision}/undo"), "Undone.")


@router.get(PATH + "/{item}/picture")
def get_picture(
    page: CurrentPage, item: uuid.UUID, width: Annotated[int, Query(ge=64, le=4096)] = 1600
) -> Response:
    """An item's picture."""
    content = _review(page).picture(item, width)
    return Response(
        content, media_type="image/jpeg", headers={"Cache-Control": "private, no-store"}
    )


@router.get(STUDY_PAGES + "/agreement")
def get_agreement(
    page: CurrentPage, output: Annotated[str, Query(alias="format", max_length=8)] = ""
) -> Response:
    """How far the reviewers agree; as CSV their decisions. Owners see the known items' results, too."""
    study = page.require_study()
    with page.database.read() as session:
        if output == "csv":
            made = [each for item in decided_by_two(session, study.id) for each in item]
            rows = [render_decision(each) for each in made]
            return csv_file(DecisionOut, rows, f"decisions-of-{study.code}")
        return page.render(
            "agreement.html",
            rows=study_agreement(session, study.id),
            known=known_results(session, study.id) if page.may("owner") else [],
        )


def _review(page: Page) -> BlindReview:
    return BlindReview(page.state, page.study_caller, page.require_study())


def _blind(
    page: Page,
    day: date | None,
    skip: Sequence[uuid.UUID],
    last: uuid.UUID | None,
    form: FormState = EMPTY_FORM,
    *,
    differing: bool,
) -> HTMLResponse:
    item = _review(page).next_item(day, skip, differing=differing)
    outline = None
    if item is not None and item.size_px is not None:
        outline = outline_in(*item.size_px, item.rings)
    return page.render(
        "blind.html",
        form=form,
        item=item,
        outline=outline,
        day=day,
        skip=skip,
        last=last,
        differing=differing,
    )
