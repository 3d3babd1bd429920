"""What logs call a request's target: the route's pattern, such as /v1/meals/{meal_id}, never the path that was sent.

Paths hold participants' codes and the ids that phones make, and a path that fits no route may hold anything.
"""

from collections.abc import Mapping
from typing import Any

NO_ROUTE = "(no route)"


def route_name(scope: Mapping[str, Any]) -> str:
    """The pattern of the route that took the request of this ASGI scope, or NO_ROUTE."""
    return getattr(scope.get("route"), "path", NO_ROUTE)
