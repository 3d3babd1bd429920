"""The OpenAPI document: whole, and its examples are what they are examples of."""

import pytest

from app.core.settings import Settings
from app.main import create_app
from app.people.access.access_rules import RULES
from app.people.schemas import ParticipantIn, StudyIn
from app.records.meal_schemas import MealMetadataIn, MealOut, NewMealMetadataIn


@pytest.fixture(scope="module")
def document():
    return create_app(Settings()).openapi()


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


@pytest.mark.parametrize("model", [MealOut, MealMetadataIn, NewMealMetadataIn, StudyIn, ParticipantIn])
def test_example_is_valid(document, model):
    assert document["components"]["schemas"][model.__name__]["example"]
    model.model_validate(model.model_config["json_schema_extra"]["example"])  # FastAPI drops nulls from the document


def test_only_what_the_rules_open_needs_no_token(document):
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            is_open = not operation.get("security")
            assert is_open == RULES[(method.upper(), path)].is_open, (method, path)

    opened = {path for method, path in RULES if RULES[(method, path)].is_open}
    assert opened == {
        "/v1/enrolments",
        "/v1/sessions",
        "/v1/receipts/{receipt}",
        "/healthz",
        "/readyz",
        "/v1/server",
    } | {
        "/fhir/metadata",
        "/fhir/StructureDefinition/{name}",
        "/",
        "/dashboard/sign-in",
    }
