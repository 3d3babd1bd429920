"""The OpenAPI document: whole."""

import pytest
from fastapi.routing import APIRoute

from app.people.access.access_rules import OF_API, RULES, list_parameters
from app.people.schemas import ParticipantIn, StudyIn
from app.records.meal_schemas import MealMetadataIn, NewMealMetadataIn


def test_query_parameters_of_routes_are_those_of_the_document(app, document):
    routers = [included.original_router for included in app.routes if hasattr(included, "original_router")]
    routes = [route for router in routers for route in router.routes if isinstance(route, APIRoute)]
    routes = [route for route in routes if route.path.startswith(OF_API)]
    assert len(routes) > 80
    for route in routes:
        for method in route.methods:
            parameters = document["paths"][route.path][method.lower()].get("parameters", ())
            schemas = {each["name"]: each["schema"] for each in parameters if each["in"] == "query"}
            assert list_parameters(route) == {
                name: any(part.get("type") == "array" for part in (schema, *schema.get("anyOf", ())))
                for name, schema in schemas.items()
            }, route.path


def test_every_reference_leads_somewhere(document):
    def references(value):
        if isinstance(value, dict):
            if isinstance(value.get("$ref"), str):
                yield value["$ref"]
            for part in value.values():
                yield from references(part)
        elif isinstance(value, list):
            for part in value:
                yield from references(part)

    parts = {f"#/components/{kind}/{name}" for kind, named in document["components"].items() for name in named}
    assert set(references(document)) <= parts


@pytest.mark.parametrize("model", [MealMetadataIn, NewMealMetadataIn, StudyIn, ParticipantIn])
def test_example_passes_the_models_own_checks(model):
    model.model_validate(model.model_config["json_schema_extra"]["example"])


def test_only_what_the_rules_open_needs_no_token(operations):
    for call, operation in operations.items():
        assert (not operation.get("security")) == RULES[call].is_open, call
    assert {path for (_, path), rule in RULES.items() if rule.is_open} == {
        "/v1/enrolments", "/v1/sessions", "/v1/receipts/{receipt}", "/healthz", "/readyz", "/v1/server",
        "/fhir/metadata", "/fhir/StructureDefinition/{name}", "/", "/dashboard/sign-in",
    }  # fmt: skip
