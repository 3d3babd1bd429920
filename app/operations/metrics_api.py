"""/metrics: figures of this process and of the deployment in Prometheus' text format. Access: metrics/reader.py."""

from collections.abc import Iterator
from typing import Annotated

from fastapi import APIRouter, Header, Response
from prometheus_client import Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from app.metrics import instruments
from app.operations.figures import DeploymentFigures
from app.people.access.deps import State

router = APIRouter(tags=["health"])


class _All(Collector):
    """Both sets of figures as one collector, since the format has one end marker."""

    def __init__(self, deployment: DeploymentFigures) -> None:
        self._deployment = deployment

    def collect(self) -> Iterator[Metric]:
        yield from instruments.collect()
        yield from self._deployment.collect()


@router.get("/metrics", include_in_schema=False)
def get_metrics(state: State, accept: Annotated[str, Header()] = "") -> Response:
    """Return the figures for Prometheus."""
    encode, content_type = choose_encoder(accept)
    return Response(
        encode(_All(state.part(DeploymentFigures))),
        headers={"Content-Type": content_type, "Cache-Control": "no-store"},
    )
