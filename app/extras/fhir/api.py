"""/fhir: records as read-only FHIR R5 resources."""

import uuid
from typing import Annotated, Any

from fastapi import APIRouter, Depends, FastAPI, Path, Request
from fastapi.responses import Response

from app.core.errors import NotFoundError
from app.extras.fhir.answers import (
    FHIR_JSON,
    FHIR_PATHS,
    PREFIX,
    FhirErrors,
    FhirJson,
    require_json,
    wants_strict,
)
from app.extras.fhir.capability import (
    EXTENSIONS,
    SEARCH_PARAMETERS,
    capability_statement,
    structure_definition,
)
from app.extras.fhir.fhir_intakes import read_intake, read_person, search_intakes
from app.extras.fhir.names import names_of, patient_id, person_of_id
from app.extras.fhir.resources import Intakes, patient, search_bundle
from app.extras.fhir.search import CURSOR, DEFAULT_COUNT, MOST_COUNT, read_search
from app.http.answers import AroundPath
from app.http.problems import problem_responses
from app.people.access.access_rules import OPEN, VIEWER_OR_DEVICE, rules_of
from app.people.access.deps import CurrentCaller, State

router = APIRouter(prefix=PREFIX, tags=["fhir"], dependencies=[Depends(require_json)])

CALLS = {
    "GET /fhir/metadata": OPEN,
    "GET /fhir/StructureDefinition/{name}": OPEN,
    "GET /fhir/NutritionIntake": VIEWER_OR_DEVICE,
    "GET /fhir/NutritionIntake/{intake_id}": VIEWER_OR_DEVICE,
    "GET /fhir/Patient/{patient_id}": VIEWER_OR_DEVICE,
}

OUTCOME = {FHIR_JSON: {"schema": {"type": "object"}}}
ETAG = {"headers": {"ETag": {"$ref": "#/components/headers/ETag"}}}

LogicalId = Annotated[str, Path(max_length=200, description="The resource's logical id.")]


def install(app: FastAPI) -> None:
    """Add the routes to an app, with FHIR's own form of errors."""
    app.state.rules |= rules_of(CALLS)
    app.include_router(router)
    app.add_middleware(AroundPath, pattern=FHIR_PATHS, middleware=FhirErrors)
    document = app.openapi
    app.openapi = lambda: _with_outcomes(document())  # type: ignore[method-assign]


def _with_outcomes(document: dict[str, Any]) -> dict[str, Any]:
    """Change the problem documents of these routes in an OpenAPI document into OperationOutcomes."""
    for method, path in rules_of(CALLS):
        responses = document["paths"][path][method.lower()]["responses"]
        responses.pop("422", None)  # an unacceptable value is 400 here
        for status, response in responses.items():
            if int(status) >= 400:
                response["content"] = OUTCOME
    return document


def _responses(description: str, *error_statuses: int) -> dict[int | str, dict[str, object]]:
    outcome: dict[str, object] = {"description": "OperationOutcome", "content": OUTCOME}
    return {
        200: {"description": description, "content": OUTCOME},
        **dict.fromkeys(error_statuses, outcome),
    }


def _parameter(name: str, description: str, *, is_list: bool = False) -> dict[str, object]:
    schema = {"type": "string"}
    return {
        "name": name,
        "in": "query",
        "required": False,
        "description": description,
        "schema": {"type": "array", "items": schema} if is_list else schema,
    }


SEARCH_IN_OPENAPI = {
    "parameters": [
        *(_parameter(name, text, is_list=name == "date") for name, _, text in SEARCH_PARAMETERS),
        _parameter(
            "_count", f"Resources on a page: {DEFAULT_COUNT} by default, {MOST_COUNT} at most."
        ),
        _parameter(CURSOR, "From the page before: follow `next`."),
    ]
}


@router.get("/metadata", responses=_responses("CapabilityStatement", 406))
def get_capability_statement(request: Request) -> Response:
    """The server's CapabilityStatement."""
    return FhirJson(
        capability_statement(names_of(request)), headers={"Cache-Control": "public, max-age=3600"}
    )


@router.get(
    "/StructureDefinition/{name}",
    responses=_responses("StructureDefinition", 404, 406) | problem_responses(400),
)
def get_structure_definition(
    request: Request,
    name: Annotated[str, Path(max_length=200, description="The extension's name.")],
) -> Response:
    """The definition of one of this server's extensions."""
    for extension in EXTENSIONS:
        if extension.name == name:
            definition = structure_definition(names_of(request), extension)
            return FhirJson(definition, headers={"Cache-Control": "public, max-age=3600"})
    raise NotFoundError("There is no such StructureDefinition.")


@router.get(
    "/NutritionIntake",
    responses=_responses("Bundle of NutritionIntakes", 400, 401, 406, 503),
    openapi_extra=SEARCH_IN_OPENAPI,
)
def search_nutrition_intakes(request: Request, state: State, caller: CurrentCaller) -> Response:
    """Records that count, one per food of a meal, in the order of capture: a searchset, page by page."""
    names = names_of(request)
    query = read_search(request.query_params.multi_items(), names, is_strict=wants_strict(request))
    page = search_intakes(
        state.database, caller, query.search, cursor=query.cursor, limit=query.count
    )
    return FhirJson(search_bundle(names, query, page))


INTAKE_RESPONSES = _responses("NutritionIntake", 401, 404, 406, 410, 503) | problem_responses(400)
INTAKE_RESPONSES[200] |= ETAG


@router.get("/NutritionIntake/{intake_id}", responses=INTAKE_RESPONSES)
def get_nutrition_intake(
    request: Request, intake_id: LogicalId, state: State, caller: CurrentCaller
) -> Response:
    """One record."""
    try:
        item_id = uuid.UUID(intake_id)
    except ValueError:
        raise NotFoundError("There is no such NutritionIntake.") from None
    intake = read_intake(state.database, caller, item_id)
    return FhirJson(
        Intakes(names_of(request)).resource(intake),
        headers={"ETag": f'W/"{intake.row.record.change_seq}"'},
    )


@router.get(
    "/Patient/{patient_id}",
    responses=_responses("Patient", 401, 404, 406, 503) | problem_responses(400),
)
def get_patient(
    request: Request,
    logical_id: Annotated[
        str,
        Path(
            alias="patient_id",
            max_length=200,
            description="The Patient's logical id, as resources refer to it.",
        ),
    ],
    state: State,
    caller: CurrentCaller,
) -> Response:
    """A participant: a code in a study."""
    name = person_of_id(logical_id)
    if (
        name is None
        or name.study_code is None
        or patient_id(name.study_code, name.code) != logical_id
    ):
        raise NotFoundError("There is no such Patient.")
    participant, study_code = read_person(state.database, caller, name)
    return FhirJson(patient(names_of(request), participant, study_code))
