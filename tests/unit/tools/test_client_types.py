"""The Python client's types are those of the OpenAPI document."""

import pytest

from tools.client_types import TARGET, python_source


@pytest.mark.slow
def test_types_of_the_python_client_are_those_of_the_document():
    assert TARGET.read_text("utf-8") == python_source(), "run: python -m tools.client_types"
