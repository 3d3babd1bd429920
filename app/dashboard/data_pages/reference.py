"""A study's days against a reference method: the figures by nutrient, and the form for owners to upload its days."""

from typing import Annotated

import anyio.to_thread
from fastapi import APIRouter, Query
from starlette.responses import Response

from app.core.errors import InvalidInputError
from app.dashboard.forms import EMPTY_FORM, FormState, refused
from app.dashboard.page import CurrentPage, Page, csv_file
from app.diary.references.compare_reference import compare_with_reference
from app.diary.references.reference_days import replace_reference
from app.diary.references.schemas import NutrientAgreementOut
from app.http.upload import METADATA, UploadLimits, received_parts
from app.nutrition.components import HEADLINE_BY_COLUMN, HEADLINE_COLUMNS
from app.people.access.page_rules import STUDY_PAGES, study_address

router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/reference"
LIMITS = UploadLimits(photo_bytes=0, metadata_bytes=256 * 1024)  # as of other calls


@router.get(PATH)
def get_reference(
    page: CurrentPage, output: Annotated[str, Query(alias="format", max_length=8)] = ""
) -> Response:
    """How far the study agrees with the reference, by nutrient; as CSV the same figures."""
    return _reference(page, output)


@router.post(PATH)
async def post_reference(page: CurrentPage) -> Response:
    """Replace the reference days by a file's."""
    state = page.state
    async with received_parts(
        page.request, (), state.blobs.staging_folder(), LIMITS, state.upload_limiter
    ) as parts:

        def replace() -> Response:
            content = parts.metadata or b""
            try:
                days = replace_reference(page.database, page.caller, page.study_code, content)
            except InvalidInputError as error:
                return _reference(page, form=refused(error, name=METADATA))
            path = study_address(page.study_code, "reference")
            return page.redirect(path, f"The reference has {days} days.")

        return await anyio.to_thread.run_sync(replace)


def _reference(page: Page, output: str = "", form: FormState = EMPTY_FORM) -> Response:
    study = page.require_study()
    with page.database.read() as session:
        compared = compare_with_reference(session, study.id)
    if output == "csv":
        rows = [figures for figures, _ in compared]
        return csv_file(NutrientAgreementOut, rows, f"reference-agreement-of-{study.code}")
    return page.render(
        "reference.html",
        form=form,
        compared=[(HEADLINE_BY_COLUMN[row.nutrient], row, limits) for row, limits in compared],
        columns=HEADLINE_COLUMNS,
    )
