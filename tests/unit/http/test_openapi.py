"""The OpenAPI document as a contract: valid, whole, with examples, closed sets as enums, and what can come back."""

import re

import pytest
from jsonschema import Draft202012Validator
from openapi_spec_validator import OpenAPIV31SpecValidator

from app.exports.models import EXPORT_STATES
from app.exports.release_models import RELEASE_STATES
from app.meals.stored.event_models import DAY_STATUSES, EVENT_KINDS, LAYERS
from app.meals.stored.models import MEAL_ORIGINS, MEAL_STATUSES
from app.meals.stored.record_models import ITEM_ORIGINS, RECORD_STATUSES
from app.openapi import COMPARE_CLOCKS, COUNTED_AT_401, LOCATED, LOCATED_AGAIN, TAGGED
from app.outbox.models import DELIVERY_STATES
from app.people.models import ROLES


def test_only_what_the_rules_open_needs_no_token(app, operations):
    for call, operation in operations.items():
        assert (not operation.get("security")) == app.state.rules[call].is_open, call
    assert {path for (_, path), rule in app.state.rules.items() if rule.is_open} == {
        "/v1/enrolments", "/v1/sessions", "/v1/receipts/{receipt}", "/healthz", "/readyz", "/v1/server",
        "/fhir/metadata", "/fhir/StructureDefinition/{name}", "/", "/dashboard/sign-in",
        "/dashboard/sign-in/institution", "/dashboard/sign-in/return",
    }  # fmt: skip


NAME = re.compile(r"^(get|post|put|patch|delete|search)(_[a-z]+)+$")


def test_document_is_valid(document):
    assert [error.message for error in OpenAPIV31SpecValidator(document).iter_errors()] == []


def test_every_operation_has_an_id_a_summary_and_a_tag_and_no_parameter_twice(operations):
    ids = [operation["operationId"] for operation in operations.values()]
    assert [each for each in ids if not NAME.match(each)] == []
    assert len(set(ids)) == len(ids)
    assert set(ids) >= LOCATED | LOCATED_AGAIN | TAGGED | COUNTED_AT_401 | COMPARE_CLOCKS
    for call, operation in operations.items():
        assert operation["summary"], call
        assert operation["tags"], call
        names = [(each["in"], each["name"].casefold()) for each in operation.get("parameters", ())]
        assert len(set(names)) == len(names), call


def test_every_refusal_is_a_problem_document(operations):
    for (method, path), operation in operations.items():
        is_fhir = path.startswith("/fhir")
        for status, response in operation["responses"].items():
            if int(status) >= 400 and path != "/readyz":
                kind = "application/fhir+json" if is_fhir else "application/problem+json"
                assert list(response["content"]) == [kind], (method, path, status)
                schema = response["content"][kind]["schema"]
                assert is_fhir or schema == {"$ref": "#/components/schemas/Problem"}, (method, path, status)


def test_what_stands_around_an_endpoint_is_declared(app, operations):
    for call, operation in operations.items():
        rule, statuses = app.state.rules[call], set(operation["responses"])
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


MAPS, LISTS, SINGLE = {"properties", "patternProperties"}, {"anyOf", "oneOf", "allOf", "prefixItems"}, {"items", "not"}


def parts(schema, place):
    """A schema and all inside it, each with its place."""
    if not isinstance(schema, dict):
        return
    yield place, schema
    for keyword, value in schema.items():
        inside = {}
        if keyword in MAPS:
            inside = value
        elif keyword in LISTS:
            inside = dict(enumerate(value))
        elif keyword in SINGLE | {"additionalProperties", "propertyNames"}:
            inside = {keyword: value}
        for name, part in inside.items():
            yield from parts(part, (*place, name))


@pytest.fixture(scope="module")
def schemas(document, operations):
    named = [part for name, schema in document["components"]["schemas"].items() for part in parts(schema, (name,))]
    return named + [
        part
        for call in operations.values()
        for parameter in call.get("parameters", ())
        for part in parts(parameter["schema"], (call["operationId"], parameter["name"]))
    ]


def test_examples_are_valid_and_limits_of_numbers_in_the_document(document, schemas):
    share = document["components"]["schemas"]["DeclaredItemIn"]["properties"]["share"]
    assert (share["minimum"], share["maximum"]) == (0.001, 1)
    examples = {
        (*place, number): (schema, example)
        for place, schema in schemas
        for number, example in enumerate(
            [*([schema["example"]] if "example" in schema else []), *schema.get("examples", ())]
        )
    }
    assert len(examples) > 40
    for place, (schema, example) in examples.items():
        validator = Draft202012Validator(schema | {"components": document["components"]})
        assert [f"{error.json_path}: {error.message}" for error in validator.iter_errors(example)] == [], place


@pytest.mark.parametrize(
    ("schema", "field", "words"),
    [
        ("MealOut", "status", MEAL_STATUSES),
        ("MealListItem", "origin", MEAL_ORIGINS),
        ("ItemOut", "status", RECORD_STATUSES),
        ("RecordOut", "origin", ITEM_ORIGINS),
        ("EventOut", "kind", EVENT_KINDS),
        ("EventOut", "layer", LAYERS),
        ("DayOut", "status", DAY_STATUSES),
        ("MemberOut", "role", ROLES),
        ("ExportOut", "state", EXPORT_STATES),
        ("ReleaseOut", "state", RELEASE_STATES),
        ("DeliveryOut", "state", DELIVERY_STATES),
    ],
)
def test_an_answer_has_all_words_that_the_database_lets_in(document, schema, field, words):
    assert document["components"]["schemas"][schema]["properties"][field]["enum"] == list(words)
