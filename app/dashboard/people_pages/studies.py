"""The first page, a study's protocol, changed by its owners, and the form for a new study, for admins."""

from collections.abc import Mapping
from typing import Literal

from fastapi import APIRouter
from starlette.responses import HTMLResponse, Response

from app.core.errors import ConflictError, InvalidInputError, PreconditionFailedError
from app.dashboard.forms import (
    EMPTY_FORM,
    Fields,
    FormState,
    WrongFormError,
    form_values,
    read_form,
    refused,
    take_version,
)
from app.dashboard.page import CurrentPage, Page
from app.exports.lists.list_meals import count_photographed
from app.exports.lists.meal_row_queries import PhotographedMeals
from app.http.paging import Cursor
from app.people import studies
from app.people.access.caller import role_in
from app.people.access.page_rules import PREFIX, study_address
from app.people.location_policy import FilesWithPlaces
from app.people.schemas import StudyIn, StudyPatch
from app.people.studies_api import protocol_columns, render_study

router = APIRouter(include_in_schema=False)

SWITCHES = ("expects_after_pair", "gives_feedback", "identifies_by_context", "shares_index")
# an emptied field removes the value
NULLABLE: tuple[Literal["retention_days", "location_decimals", "marker"], ...] = (
    "retention_days",
    "location_decimals",
    "marker",
)
MEANING: Mapping[str, str] = {  # hints below the fields
    "day_starts": "From 00:00 to 12:00: an earlier meal belongs to the day before. Fixed once the study has a meal.",
    "gives_feedback": "Feedback changes what people eat.",
    "marker": "The board that participants receive: kind, squares across x down, side in mm, such as plain:9x7:11.",
    "after_window_minutes": "From 5 to 2880, which is two days.",
    "shares_index": "All studies of this server learn from the confirmed items of this one: from figures that describe "
    "how a food looked, which food it was, and its volume. Never from photographs or personal data.",
    "identifies_by_context": "Beside a food's looks, its size counts, and what the participant and the study eat at "
    "that hour. Without them a food that is eaten often is not named more easily than another.",
    "location_policy": "If places are not kept, earlier ones are no longer shown either, and exports that contain them "
    "expire; a release that was frozen with them keeps them.",
    "location_decimals": "0 to 4; 2 decimals are about a kilometre.",
    "web_origins": "Pages on these addresses may use the server with this study's phones' tokens, one per line, such "
    "as https://app.example.org; at most 20. This server's own capture page needs none.",
    "reminder_times": "Local times at which phones that want it are reminded of meals, such as 12:30 18:30; at most "
    "8. They need a server that sends reminders.",
    "retention_days": "Counted from the upload; empty: they are kept.",
}
MARKER_ASKED = "A board of another size changes every volume: agree to it below."
PATH = f"{PREFIX}/studies/{{study}}/settings"
NEW = f"{PREFIX}/new-study"
STUDIES_A_PAGE = 100


@router.get(PATH)
def get_settings(page: CurrentPage) -> Response:
    """The protocol."""
    return _settings(page)


@router.post(PATH)
def post_settings(page: CurrentPage, fields: Fields) -> Response:
    """Change the protocol if it is unchanged since the form was opened."""
    values = form_values(fields)
    expected = take_version(values)
    agreed_marker = values.pop("agreed_marker", None)
    try:
        body = read_form(StudyPatch, _protocol(values))
        if "location_policy" in values:
            _check_rounding(body)
        changes = protocol_columns(body)
        changes["name"] = body.name
        for name in NULLABLE:
            if values.get(name) == "":
                changes[name] = None
        of_marker = _meals_of_marker(page, changes)
        if of_marker is not None and agreed_marker != values["marker"]:
            form = FormState(values, {"marker": MARKER_ASKED}, 409)
            return _settings(page, form, of_marker)
        studies.change_study(
            page.database,
            page.caller,
            page.study_code,
            changes,
            expected=expected,
            files_with_places=page.state.part(FilesWithPlaces),
        )
    except PreconditionFailedError as error:
        return _settings(page, refused(error))
    except (InvalidInputError, ConflictError) as error:
        field = "web_origins" if error.code == "origin_invalid" else ""
        return _settings(page, refused(error, values, field))
    return page.redirect(study_address(page.study_code, "settings"), "The protocol was changed.")


@router.get(NEW)
def get_new_study(page: CurrentPage) -> Response:
    """The form for a new study."""
    return page.render("new_study.html")


@router.post(NEW)
def post_new_study(page: CurrentPage, fields: Fields) -> Response:
    """Create a study; its protocol follows on the settings page."""
    values = form_values(fields)
    try:
        body = read_form(StudyIn, values)
        studies.create_study(
            page.database,
            code=body.code,
            name=body.name,
            caller=page.caller,
            protocol=protocol_columns(body),
            is_sandbox=body.sandbox,
        )
    except (InvalidInputError, ConflictError) as error:
        return page.render("new_study.html", form=refused(error, values))
    return page.redirect(
        study_address(body.code, "settings"),
        f"The study {body.code} was created. This is its protocol.",
    )


def _settings(
    page: Page, form: FormState = EMPTY_FORM, of_marker: PhotographedMeals | None = None
) -> Response:
    """of_marker: the meals that a change of the marker concerns, where the owner is asked about it."""
    study = render_study(studies.read_study(page.database, page.study_code))
    return page.render(
        "settings.html",
        form=form,
        protocol=study,
        meaning=MEANING,
        switches=SWITCHES,
        of_marker=of_marker,
    )


def _meals_of_marker(page: Page, changes: studies.ProtocolChange) -> PhotographedMeals | None:
    """Return the study's photographed meals where its marker is to be changed and there are any; else None."""
    study = studies.read_study(page.database, page.study_code)
    if "marker" not in changes or changes["marker"] == study.marker:
        return None
    meals = count_photographed(page.database, study.id)
    return meals if meals.measured or meals.waiting else None


def _check_rounding(body: StudyPatch) -> None:
    """Raise WrongFormError unless decimals are given exactly for rounding; the service checks this too."""
    if body.location_policy == "round" and body.location_decimals is None:
        raise WrongFormError(
            {"location_decimals": "Places are rounded: enter the number of decimals, 0 to 4."}
        )
    if body.location_policy != "round" and body.location_decimals is not None:
        raise WrongFormError({"location_decimals": "Leave this empty: places are not rounded."})


def _protocol(values: dict[str, str]) -> dict[str, str | bool | list[str]]:
    """Return the values as the API's body has them: browsers do not send a switch that is off."""
    body: dict[str, str | bool | list[str]] = {
        name: text for name, text in values.items() if name not in SWITCHES
    }
    body |= {
        name: values[name].split() for name in ("web_origins", "reminder_times") if name in values
    }
    return body | {name: name in values for name in SWITCHES}


@router.get(PREFIX)
def get_studies(page: CurrentPage, cursor: Cursor = None) -> HTMLResponse:
    """The studies, with links to their pages."""
    listed = studies.list_studies(page.database, page.caller, cursor=cursor, limit=STUDIES_A_PAGE)
    rows = [(study, role_in(page.caller, study.id)) for study in listed.rows]
    return page.render("studies.html", rows=rows, next=listed.cursor)
