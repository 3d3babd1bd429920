"""No query parameter is passed over: a filter that is not heard gives other people's rows."""

from typing import Any

from fastapi import FastAPI, Request

from app.core.errors import InvalidInputError

OF_API = "/v1/"  # FHIR has rules of its own for these (Prefer: handling), pages of the dashboard have forms


def require_known_parameters(request: Request) -> None:
    """Raises InvalidInputError (`parameter_unknown`)."""
    path = request.scope["route"].path
    if not request.query_params or not path.startswith(OF_API):
        return
    known = _parameters(request.app, request.method.lower(), path)
    unknown = sorted(set(request.query_params) - known)
    if unknown:
        raise InvalidInputError(
            f"There is no parameter {', '.join(unknown)[:200]!r} here. There is: {', '.join(sorted(known)) or 'none'}.",
            code="parameter_unknown",
            parameters=unknown,
        )


def _parameters(app: FastAPI, method: str, path: str) -> frozenset[str]:
    """Those of the query, by the document that tells callers of them."""
    operation: dict[str, Any] = app.openapi()["paths"].get(path, {}).get(method, {})
    return frozenset(each["name"] for each in operation.get("parameters", ()) if each["in"] == "query")
