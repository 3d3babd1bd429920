"""The OpenAPI document describes every field and parameter."""

import pytest

from app.core.settings import Settings
from app.main import create_app


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    return create_app(Settings(data_dir=tmp_path_factory.mktemp("descriptions"))).openapi()


def test_no_field_is_without_a_description(document):
    fields = {
        (schema, name): field
        for schema, content in document["components"]["schemas"].items()
        for name, field in content.get("properties", {}).items()
    }
    assert len(fields) > 1000
    assert [name for name, field in fields.items() if not field.get("description", "").strip()] == []


def test_no_parameter_is_without_a_description(document):
    parameters = {
        (method, path, parameter["in"], parameter["name"]): parameter
        for path, operations in document["paths"].items()
        for method, operation in operations.items()
        for parameter in operation.get("parameters", ())
    }
    assert len(parameters) > 250
    assert [name for name, parameter in parameters.items() if not parameter.get("description", "").strip()] == []
