"""A page of records as a searchset: its resources, what was used of the query, and where it goes on."""

from typing import Any
from urllib.parse import urlencode

from app.exports.fhir.answers import outcome_issue
from app.exports.fhir.names import Names
from app.exports.fhir.queries import IntakeRow
from app.exports.fhir.resources import Intakes
from app.exports.fhir.search import CURSOR, Asked
from app.http.paging import Page


def search_bundle(names: Names, asked: Asked, page: Page[IntakeRow]) -> dict[str, Any]:
    """The bundle. It has no total: that would mean to count what nobody looks at."""
    intakes, here = Intakes(names), names.url("NutritionIntake")
    links = [{"relation": "self", "url": _url(here, asked.used, asked.cursor)}]
    if page.cursor is not None:
        links.append({"relation": "next", "url": _url(here, asked.used, page.cursor)})
    entries = [
        {"fullUrl": f"{here}/{row.of.record.item_id}", "resource": intakes.resource(row), "search": {"mode": "match"}}
        for row in page.rows
    ]
    if asked.ignored:
        entries.append({"resource": _ignored(names, asked.ignored), "search": {"mode": "outcome"}})
    return {"resourceType": "Bundle", "type": "searchset", "link": links} | ({"entry": entries} if entries else {})


def _ignored(names: Names, parameters: tuple[str, ...]) -> dict[str, Any]:
    system = names.system("errors")
    text = "Ignored, since it is not supported here: {}. GET /fhir/metadata lists what is."
    return {
        "resourceType": "OperationOutcome",
        "issue": [
            outcome_issue("warning", "not-supported", "search_parameter_unsupported", system, text.format(name))
            for name in parameters
        ],
    }


def _url(here: str, used: tuple[tuple[str, str], ...], cursor: str | None) -> str:
    query = urlencode([*used, *([(CURSOR, cursor)] if cursor is not None else [])])
    return f"{here}?{query}" if query else here
