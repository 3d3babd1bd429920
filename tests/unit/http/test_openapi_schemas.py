"""Schemas of the OpenAPI document: only what JSON Schema knows, and examples that are valid."""

import pytest
from jsonschema import Draft202012Validator

OF_OPENAPI = {"discriminator", "example"}
OF_FORMS = {"examples", "title", "description", "default", "deprecated", "readOnly", "writeOnly", "format"}
MAPS, LISTS, SINGLE = {"properties", "patternProperties"}, {"anyOf", "oneOf", "allOf", "prefixItems"}, {"items", "not"}
KEYWORDS = set(Draft202012Validator.VALIDATORS) | OF_OPENAPI | OF_FORMS


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


def test_schemas_have_keywords_of_json_schema_only(schemas):
    assert len(schemas) > 3000
    assert {keyword: place for place, schema in schemas for keyword in schema if keyword not in KEYWORDS} == {}


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


def test_every_json_body_of_a_request_and_every_answer_of_a_phones_conversation_has_an_example(document, operations):
    named = document["components"]["schemas"]

    def has_example(schema):
        if "$ref" in schema:
            schema = named[schema["$ref"].rpartition("/")[2]]
        return "example" in schema or any(has_example(choice) for choice in schema.get("oneOf", ()))

    bodies = {
        operation["operationId"]: operation["requestBody"]["content"]["application/json"]["schema"]
        for operation in operations.values()
        if "application/json" in operation.get("requestBody", {}).get("content", {})
    }
    assert len(bodies) > 25
    assert [call for call, schema in bodies.items() if not has_example(schema)] == []
    answers = ["EnrolmentOut", "MeOut", "CheckOut", "MealOut", "FoodList", "DayOut", "SummaryOut", "ReceiptOut"]
    assert [name for name in [*answers, "Problem"] if "example" not in named[name]] == []
