"""The app and its OpenAPI document, which several files assert on: made once per worker, and read-only."""

import pytest

from app.core.settings import Settings
from app.main import create_app


@pytest.fixture(scope="session")
def app():
    return create_app(Settings())


@pytest.fixture(scope="session")
def document(app):
    return app.openapi()


@pytest.fixture(scope="session")
def operations(document):
    """By (method, path)."""
    return {
        (method.upper(), path): operation
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    }
