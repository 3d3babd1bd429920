"""/healthz: the process answers. /readyz: it can accept meals. /metrics: figures for Prometheus.

Readiness depends only on database, blob store and disk. A long queue or a dead worker is reported,
but meals are accepted. Access to metrics: metrics/server.py.
"""

from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Annotated, Literal

import sqlalchemy as sa
from fastapi import APIRouter, Header, Response
from prometheus_client import Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector
from pydantic import BaseModel, Field

from app.core.settings import Settings
from app.db.schema_state import SchemaState, schema_state
from app.db.session import Database
from app.jobs.leases import living_workers
from app.meals.stored import queries as meals
from app.metrics import instruments
from app.operations.figures import DeploymentFigures
from app.people.access.deps import State
from app.storage.blob_store import BlobStore

router = APIRouter(tags=["health"])


class Ready(BaseModel):
    """Whether meals can be taken, and how the queue stands."""

    ready: bool = Field(description="Whether meals can be taken.")
    checks: dict[str, str] = Field(description="Each `ok`, or what is wrong.")
    workers_alive: int = Field(description="Reported only: no worker refuses no meal.")
    oldest_waiting_seconds: float | None = Field(
        description="Age of the meal that has waited longest, null if none."
    )


def check_readiness(database: Database, blobs: BlobStore, settings: Settings) -> Ready:
    """Check each part that an upload needs. Does not raise for a part that fails."""
    workers, oldest = 0, None
    try:
        # code works with a newer schema too (docs/deployment.md)
        if schema_state(database) is not SchemaState.OLDER:
            state = "ok"
            workers = len(living_workers(database))
            with database.read() as session:
                oldest = meals.oldest_waiting(session)
        else:
            state = "the schema is not up to date: run `tada db upgrade`"
    except sa.exc.SQLAlchemyError as error:
        state = f"no answer ({type(error).__name__})"
    checks = {"database": state}
    try:
        blobs.check()
        free = blobs.free_bytes()
    except OSError as error:
        checks["blob_store"] = f"cannot be written ({error.strerror})"
    else:
        checks["blob_store"] = "ok"
        low = free < settings.min_free_bytes
        checks["disk"] = f"{free} bytes free, less than {settings.min_free_bytes}" if low else "ok"
    waited = (datetime.now(UTC) - oldest).total_seconds() if oldest is not None else None
    return Ready(
        ready=all(state == "ok" for state in checks.values()),
        checks=checks,
        workers_alive=workers,
        oldest_waiting_seconds=waited,
    )


class Health(BaseModel):
    """The process is alive."""

    status: Literal["ok"] = Field(default="ok", description="ok: the process answers.")


@router.head("/healthz", include_in_schema=False)  # load balancers ask so
@router.get("/healthz")
async def get_health() -> Health:
    """The server is alive."""
    return Health()


@router.head("/readyz", include_in_schema=False)
@router.get("/readyz", responses={503: {"model": Ready, "description": "Not ready: see checks."}})
def get_ready(state: State, response: Response) -> Ready:
    """Ready for meals or not."""
    ready = check_readiness(state.database, state.blobs, state.settings)
    response.status_code = 200 if ready.ready else 503
    return ready


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
