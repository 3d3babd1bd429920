"""/healthz: the process answers. /readyz: it can take meals; how the workers are is told, but refuses nothing."""

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
    oldest_waiting_seconds: float | None = Field(description="Age of the meal that has waited longest, null if none.")


@router.head("/healthz", include_in_schema=False)  # load balancers ask so
@router.get("/healthz")
async def get_health() -> Health:
    """Alive."""
    return Health()


@router.head("/readyz", include_in_schema=False)
@router.get("/readyz", responses={503: {"model": Ready, "description": "Not ready: see checks."}})
def get_ready(state: State, response: Response) -> Ready:
    """Ready for meals or not."""
    found = check_readiness(state.database, state.blobs, state.settings)
    response.status_code = 200 if found.is_ready else 503
    return Ready(
        ready=found.is_ready,
        checks=found.checks,
        workers_alive=found.workers_alive,
        oldest_waiting_seconds=found.oldest_waiting_seconds,
    )
