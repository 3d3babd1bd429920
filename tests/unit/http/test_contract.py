"""The OpenAPI document as a contract: it is valid, and says of each call what can come back."""

import re

from openapi_spec_validator import OpenAPIV31SpecValidator

from app.openapi import COMPARE_CLOCKS, COUNTED_AT_401, LOCATED, LOCATED_AGAIN, TAGGED
from app.people.access.access_rules import RULES

NAME = re.compile(r"^(get|post|put|patch|delete|search)(_[a-z]+)+$")


def test_document_is_valid(document):
    assert [error.message for error in OpenAPIV31SpecValidator(document).iter_errors()] == []


def test_every_operation_has_an_id_a_summary_and_a_tag_and_no_parameter_twice(operations):
    ids = [operation["operationId"] for operation in operations.values()]
    assert [each for each in ids if not NAME.match(each)] == []
    assert len(set(ids)) == len(ids)
    assert set(ids) >= LOCATED | LOCATED_AGAIN | TAGGED | COUNTED_AT_401 | COMPARE_CLOCKS
    summaries = [operation["summary"] for operation in operations.values()]
    assert [each for each in summaries if not 7 <= len(each) <= 110 or " " not in each] == []
    assert len(set(summaries)) > 0.9 * len(summaries)
    for call, operation in operations.items():
        made_of_the_id = operation["operationId"].replace("_", " ").casefold()
        assert operation["summary"].casefold() != made_of_the_id, call
        assert operation["tags"], call
        names = [(each["in"], each["name"].casefold()) for each in operation.get("parameters", ())]
        assert len(set(names)) == len(names), call


def test_every_field_and_parameter_has_a_description(document, operations):
    fields = {
        (schema, name): field
        for schema, content in document["components"]["schemas"].items()
        for name, field in content.get("properties", {}).items()
    }
    parameters = {
        (call, parameter["in"], parameter["name"]): parameter
        for call, operation in operations.items()
        for parameter in operation.get("parameters", ())
    }
    assert (len(fields) > 1000, len(parameters) > 250) == (True, True)
    described = fields | parameters
    assert [name for name, each in described.items() if not each.get("description", "").strip()] == []


def test_no_two_schemas_share_a_name(document):
    """FastAPI tells them apart by their modules' paths, and generators of clients drop them."""
    names = [name.casefold() for name in document["components"]["schemas"]]
    assert [name for name in names if "__" in name] == []
    assert len(set(names)) == len(names)


def test_every_refusal_is_a_problem_document(operations):
    for (method, path), operation in operations.items():
        is_fhir = path.startswith("/fhir")
        for status, response in operation["responses"].items():
            if int(status) >= 400 and path != "/readyz":
                kind = "application/fhir+json" if is_fhir else "application/problem+json"
                assert list(response["content"]) == [kind], (method, path, status)
                schema = response["content"][kind]["schema"]
                assert is_fhir or schema == {"$ref": "#/components/schemas/Problem"}, (method, path, status)


def test_what_stands_around_an_endpoint_is_declared(operations):
    for call, operation in operations.items():
        rule, statuses = RULES[call], set(operation["responses"])
        if not rule.is_open:
            assert {"401", "403"} <= statuses, call
        if rule.device:
            assert "410" in statuses, call
        if "requestBody" in operation:
            assert {"400", "408", "413", "415", "422"} <= statuses, call
        if call[1].startswith("/v1/"):
            assert "422" in statuses, call  # a parameter that it does not know
        if call[1] not in {"/healthz", "/readyz"}:
            assert {"429", "500", "503"} <= statuses, call


def test_if_match_is_required_where_its_absence_is_refused(operations):
    names = {call: [each.get("name", "").lower() for each in o.get("parameters", ())] for call, o in operations.items()}
    refusing = {call for call, operation in operations.items() if "428" in operation["responses"]}
    assert len(refusing) >= 7
    for call in refusing:
        assert "if-match" in names[call], call
        (header,) = (each for each in operations[call]["parameters"] if each.get("name", "").lower() == "if-match")
        assert header["required"], call
        assert header["schema"]["type"] == "string", call


def test_headers_are_declared(document, operations):
    assert {"Retry-After", "Location", "ETag", "RateLimit"} <= set(document["components"]["headers"])
    for call, operation in operations.items():
        for status, response in operation["responses"].items():
            headers = set(response.get("headers", ()))
            assert (status in {"408", "429", "503"}) <= ("Retry-After" in headers), (call, status)
    made = operations["POST", "/v1/meals"]["responses"]["202"]["headers"]
    assert {"Location", "ETag", "RateLimit", "RateLimit-Policy"} <= set(made)
