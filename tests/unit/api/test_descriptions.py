"""The OpenAPI document describes every field and parameter."""

import pytest

from app.main import create_app
from app.settings import Settings


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
