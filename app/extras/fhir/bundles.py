"""A page of records as a searchset: resources, the parameters that were used, and the link to the next page."""

from urllib.parse import urlencode

from pydantic import JsonValue

from app.extras.fhir.answers import outcome_issue
from app.extras.fhir.names import Names, Resource
from app.extras.fhir.queries import IntakeRow
from app.extras.fhir.resources import Intakes
from app.extras.fhir.search import CURSOR, SearchQuery
from app.http.paging import Page


def search_bundle(names: Names, query: SearchQuery, page: Page[IntakeRow]) -> Resource:
    """Return the bundle, without a total, which would require counting all matches."""
    intakes, here = Intakes(names), names.url("NutritionIntake")
    links: list[JsonValue] = [{"relation": "self", "url": _url(here, query.used, query.cursor)}]
    if page.cursor is not None:
        links.append({"relation": "next", "url": _url(here, query.used, page.cursor)})
    entries: list[JsonValue] = [
        {
            "fullUrl": f"{here}/{intake.row.record.item_id}",
            "resource": intakes.resource(intake),
            "search": {"mode": "match"},
        }
        for intake in page.rows
    ]
    if query.ignored:
        entries.append({"resource": _ignored(names, query.ignored), "search": {"mode": "outcome"}})
    bundle: Resource = {"resourceType": "Bundle", "type": "searchset", "link": links}
    return bundle | ({"entry": entries} if entries else {})


def _ignored(names: Names, parameters: tuple[str, ...]) -> Resource:
    system = names.system("errors")
    text = "Ignored, since it is not supported here: {}. GET /fhir/metadata lists the supported parameters."
    return {
        "resourceType": "OperationOutcome",
        "issue": [
            outcome_issue(
                "warning",
                "not-supported",
                "search_parameter_unsupported",
                system,
                text.format(name),
            )
            for name in parameters
        ],
    }


def _url(here: str, used: tuple[tuple[str, str], ...], cursor: str | None) -> str:
    query = urlencode([*used, *([(CURSOR, cursor)] if cursor is not None else [])])
    return f"{here}?{query}" if query else here
