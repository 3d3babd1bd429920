"""A study's vessel library: mugs and bowls that were measured once; owners add, remeasure and retire them."""

import re
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError, PreconditionFailedError
from app.dashboard.forms import (
    EMPTY_FORM,
    Fields,
    FormState,
    WrongFieldError,
    form_values,
    lines,
    number,
    read_fields,
    read_form,
    refused,
    shown,
    take_version,
)
from app.dashboard.page import CurrentPage, Page, csv_file
from app.people.access.page_rules import STUDY_PAGES, study_address
from app.vessels import study_vessels
from app.vessels.api import render_vessel, vessel_author
from app.vessels.schemas import VesselChangeIn, VesselIn, VesselOut
from app.vessels.study_vessels import VesselView
from app.vessels.vessel_measures import measured_vessel
from app.vision.vessel_frustum import frustum_floor_mm
from app.vision.vessel_library import VESSEL_KINDS, VesselModel

MARGIN_MM = 4.0
router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/vessels"
ROWS_A_PAGE = 100
NUMBERS = ("rim_diameter_mm", "height_mm", "capacity_ml", "fill_line_mm", "fill_line_ml")
CursorIn = Annotated[str | None, Query(max_length=600)]
_BETWEEN = re.compile(r"\s*[,;]\s*|\s+")


@dataclass(frozen=True, slots=True)
class VesselDrawing:
    """Millimetres, x to the right from the vessel's left edge, y downwards.

    points: of an SVG polyline. is_measured: the profile was measured, not derived from the
    capacity. line_y: the fill line's, if there is one.
    """

    width_mm: float
    height_mm: float
    points: str
    is_measured: bool
    line_y: float | None


def vessel_drawing(model: VesselModel, fill_line_mm: float | None = None) -> VesselDrawing | None:
    """Return the side view; None if no frustum holds as little as the capacity, such as of a plate with a broad rim."""
    profile = model.inside_profile_mm or _frustum(model)
    if profile is None:
        return None
    widest_mm = max(radius for radius, _ in profile)
    top_mm = max(height for _, height in profile)
    middle_mm = widest_mm + MARGIN_MM
    right = [(middle_mm + radius, MARGIN_MM + top_mm - height) for radius, height in profile]
    left = [(2 * middle_mm - x, y) for x, y in reversed(right)]
    return VesselDrawing(
        width_mm=2 * middle_mm,
        height_mm=top_mm + 2 * MARGIN_MM,
        points=" ".join(f"{x:.1f},{y:.1f}" for x, y in (*left, *right)),
        is_measured=bool(model.inside_profile_mm),
        line_y=MARGIN_MM + top_mm - fill_line_mm if fill_line_mm is not None else None,
    )


def _frustum(model: VesselModel) -> tuple[tuple[float, float], ...] | None:
    if model.capacity_ml is None:
        return None
    floor_mm = frustum_floor_mm(
        rim_diameter_mm=model.rim_diameter_mm,
        height_mm=model.height_mm,
        level_mm=model.height_mm,
        volume_ml=model.capacity_ml,
    )
    return (
        ((floor_mm, 0.0), (model.rim_diameter_mm / 2, model.height_mm))
        if floor_mm is not None
        else None
    )


@router.get(PATH)
def get_vessels(
    page: CurrentPage,
    study: str,
    cursor: CursorIn = None,
    output: Annotated[str, Query(alias="format", max_length=8)] = "",
) -> Response:
    """The library by name, including retired vessels."""
    if output == "csv":
        rows = study_vessels.all_vessels(page.database, study)
        return csv_file(VesselOut, [render_vessel(view) for view in rows], f"vessels-of-{study}")
    return _vessels(page, study, cursor=cursor)


@router.post(PATH)
def post_vessel(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Add a vessel."""
    entered = form_values(fields)
    values, wrong = _measures(entered)
    try:
        body = read_form(VesselIn, values | {"name": entered.get("name", "")}, wrong)
        view = study_vessels.add_vessel(
            page.database,
            study,
            measured_vessel(body.model_dump()),
            vessel_author(page.caller),
        )
    except (InvalidInputError, ConflictError) as error:
        name = "name" if error.code == "vessel_exists" else ""
        return _vessels(page, study, refused(error, entered, name))
    return page.redirect(
        study_address(study, "vessels"), f"“{view.vessel.name}” is in the library."
    )


@router.get(f"{PATH}/{{vessel}}")
def get_vessel(page: CurrentPage, study: str, vessel: uuid.UUID) -> Response:
    """A vessel's side view, and the form to remeasure it."""
    view = study_vessels.read_vessel(page.database, study, vessel)
    return _vessel(page, view, FormState(_entered(view)))


@router.post(f"{PATH}/{{vessel}}")
def post_measures(page: CurrentPage, study: str, vessel: uuid.UUID, fields: Fields) -> Response:
    """Replace the measures if unchanged since the form was opened; a retired vessel is in use again."""
    entered = form_values(fields)
    expected = take_version(entered)
    view = study_vessels.read_vessel(page.database, study, vessel)
    try:
        body = read_form(VesselChangeIn, *_measures(entered))
        view = study_vessels.change_vessel(
            page.database,
            study,
            vessel,
            body.model_dump(),
            vessel_author(page.caller),
            expected=expected,
        )
    except PreconditionFailedError as error:
        return _vessel(page, view, refused(error, _entered(view)))
    except (InvalidInputError, ConflictError) as error:
        return _vessel(page, view, refused(error, entered))
    return page.redirect(study_address(study, "vessels"), f"“{view.vessel.name}” has new measures.")


@router.post(f"{PATH}/{{vessel}}/retirement")
def post_retirement(page: CurrentPage, study: str, vessel: uuid.UUID) -> Response:
    """Retire a vessel; it remains visible."""
    view = study_vessels.retire_vessel(page.database, study, vessel, vessel_author(page.caller))
    return page.redirect(study_address(study, "vessels"), f"“{view.vessel.name}” is retired.")


def _vessels(
    page: Page, study: str, form: FormState = EMPTY_FORM, cursor: str | None = None
) -> Response:
    listed = study_vessels.list_vessels(
        page.database, study, is_in_use=None, cursor=cursor, limit=ROWS_A_PAGE
    )
    return page.render(
        "study_vessels.html",
        form=form,
        rows=listed.rows,
        next=listed.cursor,
        kinds=VESSEL_KINDS,
    )


def _vessel(page: Page, view: VesselView, form: FormState) -> Response:
    return page.render(
        "study_vessel.html",
        form=form,
        view=view,
        drawing=vessel_drawing(view.model, view.version.fill_line_mm),
        kinds=VESSEL_KINDS,
    )


def _measures(entered: Mapping[str, str]) -> tuple[dict[str, object], dict[str, str]]:
    """Return (values of VesselMeasures for the fields that are not empty, field -> why it cannot be read)."""
    return read_fields({name: text for name, text in entered.items() if text}, _READERS)


def _profile(text: str) -> list[list[float]]:
    return [_point(line) for line in lines(text)]


def _point(line: str) -> list[float]:
    parts = _BETWEEN.split(line)
    if len(parts) != 2:
        raise WrongFieldError(
            f"“{line[:40]}”: write the radius and the height in mm, with a comma between: 41, 95."
        )
    return [number(part) for part in parts]


def _entered(view: VesselView) -> dict[str, str]:
    """Return a vessel's measures as the texts of the form's fields."""
    version = view.version
    entered = {
        name: shown(value) for name in NUMBERS if (value := getattr(version, name)) is not None
    }
    profile = "\n".join(
        f"{shown(radius)}, {shown(height)}" for radius, height in version.inside_profile_mm
    )
    return entered | {"kind": version.kind, "inside_profile_mm": profile}


_READERS: Mapping[str, Callable[[str], object]] = {
    **dict.fromkeys(NUMBERS, number),
    "kind": str,
    "inside_profile_mm": _profile,
}
