"""A study's protocol: read by all who see the study, changed by its owners; and a new study, by admins."""

from collections.abc import Mapping

from fastapi import APIRouter
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError, PreconditionFailedError
from app.dashboard.addresses import study_address
from app.dashboard.forms import Fields, checked, take_version, typed
from app.dashboard.page import CurrentPage, Page
from app.people import studies
from app.people.access.page_rules import PREFIX
from app.people.location_policy import FilesWithPlaces
from app.people.schemas import StudyIn, StudyPatch
from app.people.studies_api import protocol_columns, render_study

router = APIRouter(include_in_schema=False)

SWITCHES = ("expects_after_pair", "gives_feedback", "shares_index")
NULLABLE = ("retention_days", "location_decimals", "marker")  # emptied, they are taken away
MEANING: Mapping[str, str] = {  # what a field's label does not say
    "day_starts": "From 00:00 to 12:00: a meal before it belongs to the day before. Fixed once a meal is in.",
    "gives_feedback": "It changes what people eat.",
    "marker": "The board that participants are given: kind, squares across x down, side in mm, as plain:9x7:11.",
    "after_window_minutes": "From 5 to 2880, which is two days.",
    "shares_index": "All studies of this server learn from the confirmed items of this one: from figures of what a "
    "food looked like, which food it was, its volume. Never photographs, nothing of persons.",
    "location_policy": "Where it is not kept, places of before are told no more either, and exports that hold them "
    "expire; a release that was frozen with them keeps them.",
    "location_decimals": "Where places are rounded, 0 to 4: 2 are about a kilometre.",
    "retention_days": "Counted from the upload; empty: they stay.",
}
PATH = f"{PREFIX}/studies/{{study}}/settings"
NEW = f"{PREFIX}/new-study"


@router.get(PATH)
def get_settings(page: CurrentPage) -> Response:
    """The protocol, each field with what its label does not say."""
    return _settings(page, {}, {})


@router.post(PATH)
def post_settings(page: CurrentPage, fields: Fields) -> Response:
    """Change the protocol as it was when the form was opened."""
    values = typed(fields)
    expected = take_version(values)
    body, wrong = checked(StudyPatch, _protocol(values))
    if body is None:
        return _settings(page, values, wrong, status=422)
    if "location_policy" in values and (wrong := _wrong_rounding(body)):
        return _settings(page, values, wrong, status=422)
    changes = protocol_columns(body) | {"name": body.name}
    changes |= {name: None for name in NULLABLE if values.get(name) == ""}
    try:
        studies.change_study(
            page.state.database,
            page.caller,
            _code(page),
            changes,
            expected=expected,
            files_with_places=page.state.part(FilesWithPlaces),
        )
    except PreconditionFailedError as error:
        return _settings(page, {}, {"": error.message}, status=412)
    except (InvalidInputError, ConflictError) as error:
        return _settings(page, values, {"": error.message}, status=error.status)
    return page.go(study_address(_code(page), "settings"), "The protocol was changed.")


@router.get(NEW)
def get_new_study(page: CurrentPage) -> Response:
    """The form of a new study."""
    return page.render("new_study.html", values={}, wrong={})


@router.post(NEW)
def post_new_study(page: CurrentPage, fields: Fields) -> Response:
    """Make a study; its protocol follows on its own page."""
    values = typed(fields)
    body, wrong = checked(StudyIn, values)
    if body is None:
        return page.render("new_study.html", status=422, values=values, wrong=wrong)
    columns = {"name": body.name, **protocol_columns(body)}
    try:
        studies.create_study(page.state.database, code=body.code, caller=page.caller, **columns)
    except (InvalidInputError, ConflictError) as error:
        return page.render("new_study.html", status=error.status, values=values, wrong={"": error.message})
    return page.go(study_address(body.code, "settings"), f"The study {body.code} was made. This is its protocol.")


def _settings(page: Page, values: dict[str, str], wrong: dict[str, str], status: int = 200) -> Response:
    study = render_study(studies.read_study(page.state.database, _code(page)))
    return page.render(
        "settings.html", status=status, protocol=study, values=values, wrong=wrong, meaning=MEANING, switches=SWITCHES
    )


def _wrong_rounding(body: StudyPatch) -> dict[str, str]:
    """What the service refuses too, in the words of the form: the decimals go with rounding and with nothing else."""
    if body.location_policy == "round" and body.location_decimals is None:
        return {"location_decimals": "Places are to be rounded: say to how many decimals, 0 to 4."}
    if body.location_policy != "round" and body.location_decimals is not None:
        return {"location_decimals": "Leave this empty: places are not rounded."}
    return {}


def _protocol(values: dict[str, str]) -> dict[str, str | bool]:
    """As the API's body has it: a switch that is off is not sent by browsers."""
    return {name: value for name, value in values.items() if name not in SWITCHES} | {
        name: name in values for name in SWITCHES
    }


def _code(page: Page) -> str:
    return str(page.request.path_params["study"])
