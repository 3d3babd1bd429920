"""A study's own measured densities; owners add and withdraw them."""

import uuid
from collections.abc import Callable, Mapping
from datetime import date
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.core.errors import InvalidInputError, NotFoundError
from app.dashboard.food_pages.foods import food_address
from app.dashboard.forms import (
    Fields,
    FormState,
    WrongFieldError,
    WrongFormError,
    form_values,
    lines,
    number,
    read_fields,
    read_form,
    refused,
)
from app.dashboard.page import CurrentPage, Page, csv_file
from app.foods import study_densities
from app.foods.edits.api import measured_density
from app.foods.edits.edit_food import Editor
from app.foods.edits.schemas import StudyDensityIn, StudyDensityOut, WithdrawalIn
from app.foods.study_densities import Measurement
from app.foods.study_densities_api import render_study_density
from app.people.access.page_rules import STUDY_PAGES, study_address

router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/densities"
FoodIn = Annotated[str, Query(max_length=100)]


def density_values(texts: Mapping[str, str]) -> tuple[dict[str, object], dict[str, str]]:
    """Return (values of a MeasuredDensityIn for the fields that are not empty, field -> why it cannot be read)."""
    return read_fields({name: text for name, text in texts.items() if text}, _READERS)


def _specimens(text: str) -> list[dict[str, float]]:
    return [_specimen(line) for line in lines(text)]


def _specimen(line: str) -> dict[str, float]:
    parts = line.replace(";", " ").split()
    if len(parts) != 2:
        raise WrongFieldError(
            f"“{line[:40]}”: write the volume in ml and the mass in g, with a blank between."
        )
    return {"volume_ml": number(parts[0]), "mass_g": number(parts[1])}


_READERS: Mapping[str, Callable[[str], object]] = {
    **dict.fromkeys(("g_per_ml", "sd_g_per_ml", "volume_step_ml"), number),
    **dict.fromkeys(("state", "kind", "weighs", "method", "reason"), str),
    "specimens": _specimens,
}


@router.get(PATH)
def get_densities(
    page: CurrentPage,
    study: str,
    food: FoodIn = "",
    output: Annotated[str, Query(alias="format", max_length=8)] = "",
) -> Response:
    """The measurements, including withdrawn ones, the newest entry first."""
    if output == "csv":
        rows = study_densities.list_study_densities(page.database, study, food.strip() or None)
        return csv_file(
            StudyDensityOut, [render_study_density(row) for row in rows], f"densities-of-{study}"
        )
    return _densities(page, study, food.strip(), FormState({"food": food.strip()}))


@router.post(PATH)
def post_density(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Add a measurement."""
    entered = form_values(fields)
    values, wrong = density_values(entered)
    values |= {"food": entered.get("food", "")}
    if entered.get("measured_on"):
        try:
            values["measured_at"] = f"{date.fromisoformat(entered['measured_on'])}T00:00:00+00:00"
        except ValueError:
            wrong["measured_on"] = "This is no day: write it as 2026-11-22."
    try:
        body = read_form(StudyDensityIn, values, wrong)
        density, specimens = measured_density(body)
        row = study_densities.add_study_density(
            page.database,
            study,
            Measurement(body.food, density, specimens, body.measured_at),
            Editor.of(page.caller, body.reason),
        )
    except (NotFoundError, InvalidInputError) as error:
        name = {"food_not_found": "food", "time_impossible": "measured_on"}.get(error.code, "")
        return _densities(page, study, "", refused(error, entered, name))
    return page.redirect(
        study_address(study, "densities"),
        f"The density of {row.food_key} is used from now on; existing records are unchanged.",
    )


@router.post(f"{PATH}/{{density}}/withdrawal")
def post_withdrawal(page: CurrentPage, study: str, density: uuid.UUID, fields: Fields) -> Response:
    """Withdraw a measurement; it remains visible."""
    try:
        body = read_form(WithdrawalIn, {"reason": form_values(fields).get("reason", "")})
    except WrongFormError as error:
        raise InvalidInputError(
            f"Enter why it is withdrawn: {error.wrong.get('reason', '')}"
        ) from None
    row = study_densities.withdraw_study_density(
        page.database, study, density, Editor.of(page.caller, body.reason)
    )
    return page.redirect(
        study_address(study, "densities"), f"The density of {row.food_key} was withdrawn."
    )


def _densities(page: Page, study: str, food: str, form: FormState) -> Response:
    rows = study_densities.list_study_densities(page.database, study, food or None)
    return page.render(
        "study_densities.html",
        form=form,
        rows=rows,
        food=food,
        food_url=food_address,
    )
