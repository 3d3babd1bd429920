"""/healthz: the process answers. /readyz: it can accept meals; the state of workers is only reported."""

from typing import Literal

from fastapi import APIRouter, Response
from pydantic import BaseModel, Field

from app.operations.health import check_readiness
from app.people.access.deps import State

router = APIRouter(tags=["health"])


class Health(BaseModel):
    """The process is alive."""

    status: Literal["ok"] = Field(default="ok", description="ok: the process answers.")


class Ready(BaseModel):
    """Whether meals can be taken, and how the queue stands."""

    ready: bool = Field(description="Whether meals can be taken.")
    checks: dict[str, str] = Field(description="Each `ok`, or what is wrong.")
    workers_alive: int = Field(description="Reported only: no worker refuses no meal.")
    oldest_waiting_seconds: float | None = Field(
        description="Age of the meal that has waited longest, null if none."
    )


@router.head("/healthz", include_in_schema=False)  # load balancers ask so
@router.get("/healthz")
async def get_health() -> Health:
    """The server is alive."""
    return Health()


@router.head("/readyz", include_in_schema=False)
@router.get("/readyz", responses={503: {"model": Ready, "description": "Not ready: see checks."}})
def get_ready(state: State, response: Response) -> Ready:
    """Ready for meals or not."""
    readiness = check_readiness(state.database, state.blobs, state.settings)
    response.status_code = 200 if readiness.is_ready else 503
    return Ready(
        ready=readiness.is_ready,
        checks=readiness.checks,
        workers_alive=readiness.workers_alive,
        oldest_waiting_seconds=readiness.oldest_waiting_seconds,
    )
