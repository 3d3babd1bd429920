"""A study's own densities: what it measured, and owners add and withdraw."""

import uuid
from collections.abc import Mapping
from datetime import date
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.core.errors import InvalidInputError, NotFoundError
from app.dashboard.addresses import study_address
from app.dashboard.data_pages.flat_file import csv_file
from app.dashboard.food_pages.density_form import density_values
from app.dashboard.food_pages.foods import food_address
from app.dashboard.forms import Fields, checked, typed
from app.dashboard.page import CurrentPage, Page
from app.foods import study_densities
from app.foods.edits.api import measured_density
from app.foods.edits.edit_food import Editor
from app.foods.edits.schemas import StudyDensityIn, StudyDensityOut, WithdrawalIn
from app.foods.study_densities import Measurement
from app.foods.study_densities_api import render_study_density
from app.people.access.page_rules import STUDY_PAGES

router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/densities"
FoodIn = Annotated[str, Query(max_length=100)]


@router.get(PATH)
def get_densities(
    page: CurrentPage, study: str, food: FoodIn = "", output: Annotated[str, Query(alias="format", max_length=8)] = ""
) -> Response:
    """The measurements, withdrawn ones too, the newest entry first."""
    if output == "csv":
        rows = study_densities.list_study_densities(page.state.database, study, food.strip() or None)
        return csv_file(StudyDensityOut, [render_study_density(row) for row in rows], f"densities-of-{study}")
    return _densities(page, study, food.strip(), {"food": food.strip()}, {})


@router.post(PATH)
def post_density(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Keep a measurement."""
    entered = typed(fields)
    values, wrong = density_values(entered)
    values |= {"food": entered.get("food", "")}
    if entered.get("measured_on"):
        try:
            values["measured_at"] = f"{date.fromisoformat(entered['measured_on'])}T00:00:00+00:00"
        except ValueError:
            wrong["measured_on"] = "This is no day: write it as 2026-11-22."
    body, more = checked(StudyDensityIn, values)
    if body is None or wrong:
        return _densities(page, study, "", entered, more | wrong, status=422)
    try:
        density, specimens = measured_density(body)
        row = study_densities.add_study_density(
            page.state.database,
            study,
            Measurement(body.food, density, specimens, body.measured_at),
            Editor.of(page.caller, body.reason),
        )
    except (NotFoundError, InvalidInputError) as error:
        field = {"food_not_found": "food", "time_impossible": "measured_on"}.get(error.code, "")
        return _densities(page, study, "", entered, {field: error.message}, status=error.status)
    return page.go(
        study_address(study, "densities"),
        f"The density of {row.food_key} counts from now on; records stay as they are.",
    )


@router.post(f"{PATH}/{{density}}/withdrawal")
def post_withdrawal(page: CurrentPage, study: str, density: uuid.UUID, fields: Fields) -> Response:
    """Take a measurement out of use; it stays to be seen."""
    body, wrong = checked(WithdrawalIn, {"reason": typed(fields).get("reason", "")})
    if body is None:
        raise InvalidInputError(f"Tell why it is withdrawn: {wrong.get('reason', '')}")
    row = study_densities.withdraw_study_density(
        page.state.database, study, density, Editor.of(page.caller, body.reason)
    )
    return page.go(study_address(study, "densities"), f"The density of {row.food_key} was withdrawn.")


def _densities(
    page: Page, study: str, food: str, values: Mapping[str, str], wrong: Mapping[str, str], status: int = 200
) -> Response:
    rows = study_densities.list_study_densities(page.state.database, study, food or None)
    return page.render(
        "study_densities.html",
        status=status,
        rows=rows,
        food=food,
        values=values,
        wrong=wrong,
        food_url=food_address,
    )
