"""What FastAPI cannot see of the API, added to its OpenAPI document.

FastAPI knows what an endpoint takes and gives when all goes well. What stands around all endpoints (who may call, what
is counted, what a body may be) follows here from the same tables that it goes by at run time.
"""

import importlib.resources
import json
from collections.abc import Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from app.http.file_formats import FORMATS
from app.http.problems import Problem, problem_responses
from app.http.rate_limit import UNCOUNTED_PATHS
from app.meals.upload.schemas import AfterMetadataIn, CheckMetadataIn
from app.people.access.access_rules import OF_API, Rule
from app.people.calibration_schemas import CalibrationMetadataIn
from app.records.meal_schemas import MealMetadataIn, NewMealMetadataIn

# read from streams, so FastAPI does not see their schemas
OUT_OF_ROUTES = (
    Problem,
    MealMetadataIn,
    NewMealMetadataIn,
    AfterMetadataIn,
    CheckMetadataIn,
    CalibrationMetadataIn,
)
OF_FASTAPI = ("HTTPValidationError", "ValidationError")  # its own form of a 422: ours is a Problem
OF_BODIES = (400, 408, 413, 415)
OF_PARAMETERS = 422
OF_ANY, NOT_NOW = 500, 503
UNKNOWN_CALLER = 401
OK, CONFLICT, FIRST_ERROR = 200, 409, 400
PART, NO_SUCH_PART = "206", 416
FILE_TYPES = frozenset(["application/zip", *(form.content_type for form in FORMATS.values())])
# pydantic's names of limits of types with a validator before them, which JSON Schema does not know
LIMITS = {"ge": "minimum", "gt": "exclusiveMinimum", "le": "maximum", "lt": "exclusiveMaximum"}
# the caller is known, the password in the body is wrong
COUNTED_AT_401 = frozenset({"post_password"})


def _text(description: str) -> dict[str, Any]:
    return {"description": description, "schema": {"type": "string"}}


def _whole_number(description: str, minimum: int) -> dict[str, Any]:
    return {"description": description, "schema": {"type": "integer", "minimum": minimum}}


HEADERS: dict[str, dict[str, Any]] = {
    "Retry-After": _whole_number("Seconds after which the same request may succeed.", minimum=0),
    "WWW-Authenticate": _text("`Bearer`."),
    "Location": _text("Where what was made is."),
    "ETag": _text(
        "The state that was answered: for `If-Match` of a change, or `If-None-Match` of the next look."
    ),
    "Content-Disposition": _text(
        "The name to save a file under: `attachment; filename=...`. Pages of JSON are without it."
    ),
    "Accept-Ranges": _text("`bytes`: parts of the file can be asked for."),
    "Content-Range": _text("Which bytes of how many are sent; of a 416, how many there are."),
    "Tus-Resumable": _text("The version of the tus protocol."),
    "Upload-Offset": _whole_number(
        "Bytes of the photograph that are here: the next piece begins there.", minimum=0
    ),
    "Upload-Length": _whole_number("Bytes of the whole photograph.", minimum=1),
    "RateLimit-Policy": _text(
        'The limit that the call is counted in: `"upload";q=120;w=60` is 120 a minute.'
    ),
    "RateLimit": _text(
        'Where the caller stands in it: `"upload";r=119;t=1` is 119 left, and full again in 1 s.'
    ),
}
OF_CALLER = ("RateLimit-Policy", "RateLimit")
IF_NONE_MATCH = {
    "name": "If-None-Match",
    "in": "header",
    "required": False,
    **_text("The ETag of what is there already: 304 if it has not changed."),
}
LOCATED = frozenset(
    {
        "post_meal", "put_meal", "put_photograph", "put_after", "post_declared_meal", "post_export", "post_release",
        "post_upload",
        "post_study", "post_participant", "post_study_density", "post_study_vessel", "post_webhook", "post_food",
        "post_density", "post_retry", "post_remeasurement",
    }
)  # fmt: skip
OF_UPLOADS = frozenset({"post_upload", "get_upload", "patch_upload"})
# their Location is in the 200 of a repeat too
LOCATED_AGAIN = frozenset({"post_declared_meal", "post_export", "post_remeasurement"})
# their 409 may be `clock_differs`
COMPARE_CLOCKS = frozenset({"post_meal", "put_meal", "put_after", "post_declared_meal"})
TAGGED = frozenset(
    {
        "post_meal", "put_meal", "put_photograph", "put_after", "get_meal", "post_declared_meal", "post_event",
        "get_photograph", "get_artefact", "get_export_file", "get_release_file",
        "put_my_day", "put_day_of_participant", "get_food", "patch_food", "post_food", "post_density", "post_restore",
        "get_study", "patch_study", "post_study", "post_cancel", "post_retry",
        "get_study_vessel", "put_study_vessel", "post_study_vessel",
        "get_webhook", "patch_webhook",
    }
)  # fmt: skip


def openapi_document(app: FastAPI) -> dict[str, Any]:
    """The whole document, made once a process."""
    if app.openapi_schema is None:
        document = get_openapi(
            title=app.title,
            version=app.version,
            description=app.description,
            license_info=app.license_info,
            routes=app.routes,
        )
        schemas = document["components"]["schemas"]
        for model in OUT_OF_ROUTES:
            found = model.model_json_schema(ref_template="#/components/schemas/{model}")
            schemas |= found.pop("$defs", {})
            schemas[model.__name__] = found
        for name, example in _examples().items():
            schemas[name]["example"] = example
        for path, operations in document["paths"].items():
            for method, operation in operations.items():
                _complete(operation, path, app.state.rules[method.upper(), path])
        for name in OF_FASTAPI:
            schemas.pop(name, None)
        _name_limits(schemas)
        document["components"]["headers"] = HEADERS
        app.openapi_schema = document
    return app.openapi_schema


def _examples() -> dict[str, Any]:
    """Examples by schema, beside those that the models have themselves."""
    text = (importlib.resources.files("app") / "openapi_examples.json").read_text("utf-8")
    examples: dict[str, Any] = json.loads(text)
    return examples


def _name_limits(schema: Any) -> None:
    """Give the limits of numbers the names of JSON Schema."""
    if isinstance(schema, list):
        for part in schema:
            _name_limits(part)
    elif isinstance(schema, dict):
        for name, value in list(schema.items()):
            if name in LIMITS and not isinstance(value, dict):  # a dict: a property of that name
                schema[LIMITS[name]] = schema.pop(name)
            elif name not in {"example", "default"}:
                _name_limits(value)


def _complete(operation: dict[str, Any], path: str, rule: Rule) -> None:
    """Add what follows from the route's rule, its place and what it takes."""
    if rule.is_open:
        operation.pop("security", None)
    operation["summary"] = (
        operation["description"].partition("\n")[0].partition(". ")[0].rstrip(".")
    )
    responses = operation["responses"]
    for status in _statuses(operation, rule, path):
        if str(status) not in responses or "HTTPValidationError" in str(responses[str(status)]):
            responses[str(status)] = problem_responses(status)[status]
    for status, response in responses.items():
        names = [
            *_headers(operation["operationId"], int(status), rule),
            *_file_headers(responses, status),
        ]
        if names:
            refs = {name: {"$ref": f"#/components/headers/{name}"} for name in names}
            response["headers"] = {**response.get("headers", {}), **refs}
    operation["responses"] = dict(sorted(responses.items()))
    _complete_conditions(operation)


def _complete_conditions(operation: dict[str, Any]) -> None:
    """Whether `If-Match` must be sent, and `If-None-Match` where it is heard."""
    for parameter in operation.get("parameters", ()):
        if parameter["name"].lower() == "if-match" and "428" in operation["responses"]:
            parameter["required"] = True
            parameter["schema"] = next(
                each for each in parameter["schema"]["anyOf"] if each["type"] != "null"
            )
    if "304" in operation["responses"]:
        others = [
            each
            for each in operation.get("parameters", ())
            if each["name"].lower() != "if-none-match"
        ]
        operation["parameters"] = [*others, IF_NONE_MATCH]


def _statuses(operation: dict[str, Any], rule: Rule, path: str) -> Iterator[int]:
    """Those of errors that do not follow from what the endpoint does."""
    if "requestBody" in operation:
        yield from OF_BODIES
    if path.startswith(OF_API):
        yield OF_PARAMETERS  # of those that it has, and for any that it has not (access.py)
    if not rule.is_open:
        yield from (401, 403, 410)  # 410: the token was a participant's who has left the study
    if "{study}" in path:
        yield 404
    if path not in UNCOUNTED_PATHS:
        yield from (429, OF_ANY, NOT_NOW)


def _headers(operation_id: str, status: int, rule: Rule) -> Iterator[str]:
    if operation_id in (LOCATED_AGAIN if status == OK else LOCATED if status in {201, 202} else ()):
        yield "Location"
    if status < FIRST_ERROR and operation_id in TAGGED:
        yield "ETag"
    if status < FIRST_ERROR and operation_id in OF_UPLOADS:
        yield from ("Tus-Resumable", "Upload-Offset", "Upload-Length")
    if status in {408, 429, NOT_NOW} or (status == CONFLICT and operation_id in COMPARE_CLOCKS):
        yield "Retry-After"
    if status == UNKNOWN_CALLER:
        yield "WWW-Authenticate"
    if not rule.is_open and (status != UNKNOWN_CALLER or operation_id in COUNTED_AT_401):
        yield from OF_CALLER


def _file_headers(responses: dict[str, Any], status: str) -> Iterator[str]:
    """Those of answers that may be a file, and of files that are given in parts."""
    if int(status) < FIRST_ERROR and FILE_TYPES & set(responses[status].get("content", ())):
        yield "Content-Disposition"
    if PART in responses and int(status) < FIRST_ERROR:
        yield "Accept-Ranges"
    if PART in responses and status in {PART, str(NO_SUCH_PART)}:
        yield "Content-Range"
