"""/v1/meals/{meal_id}: read a meal's state, wait for a change; cancel or retry its estimate.

Also the pictures of its run. For `?wait=`, one poller per process queries the database for all
meals that requests wait for: a waiting request holds a future, but no thread and no connection.
"""

import asyncio
import contextlib
import uuid
from collections.abc import Collection
from typing import Annotated, Literal

import anyio.to_thread
import sqlalchemy.exc
import structlog
from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import StreamingResponse

from app.db.session import Database
from app.http.model_response import ModelResponse
from app.http.parameters import MealId, OfWhichParticipant, is_held
from app.http.problems import Responses, problem_responses
from app.http.ranges import ClosingStream
from app.jobs.queue import JobQueue
from app.meals.stored import queries as meals
from app.meals.stored.item_state import REMEASURING
from app.meals.stored.queries import WAITING
from app.meals.upload.cancel_or_retry import cancel_meal, retry_meal
from app.people.access.deps import CurrentCaller, CurrentStaff, State
from app.records.meal_schemas import MealOut
from app.records.read_meal import MealView, open_artefact, read_meal
from app.records.render import meal_etag, tagged_meal

log = structlog.get_logger()

POLL_SECONDS = 0.25


class MealWaiter:
    """Wakes requests when their meal's version is no longer the one that they know."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._waiting: dict[uuid.UUID, dict[asyncio.Future[None], int]] = {}
        self._poller: asyncio.Task[None] | None = None
        self._is_closed = False

    async def wait(self, meal_id: uuid.UUID, known_version: int, seconds: float) -> None:
        """Return when the meal's version differs from the known one, or after `seconds`."""
        if self._is_closed:
            return
        future = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(meal_id, {})[future] = known_version
        if self._poller is None or self._poller.done():
            self._poller = asyncio.create_task(self._poll())
        try:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(future, seconds)
        finally:
            waiters = self._waiting.get(meal_id, {})
            waiters.pop(future, None)
            if not waiters:
                self._waiting.pop(meal_id, None)

    def release(self) -> None:
        """Wake all requests and let none wait any more: at shutdown each gets the current state."""
        self._is_closed = True
        for waiters in self._waiting.values():
            for future in waiters:
                if not future.done():
                    future.set_result(None)

    async def close(self) -> None:
        """Release all requests, and end the poller."""
        self.release()
        if self._poller is not None:
            self._poller.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._poller

    async def _poll(self) -> None:
        while self._waiting:
            try:
                versions = await anyio.to_thread.run_sync(self._versions, list(self._waiting))
            # without a database, requests wait until their time is over
            except sqlalchemy.exc.SQLAlchemyError:
                log.warning("wait_poll_failed", exc_info=True)
            else:
                self._wake(versions)
            await asyncio.sleep(POLL_SECONDS)

    def _versions(self, meal_ids: Collection[uuid.UUID]) -> dict[uuid.UUID, int]:
        with self._database.read() as session:
            return {row.id: row.version for row in meals.versions_of(session, meal_ids)}

    def _wake(self, versions: dict[uuid.UUID, int]) -> None:
        for meal_id, waiters in self._waiting.items():
            for future, known_version in waiters.items():
                if versions.get(meal_id) != known_version and not future.done():
                    future.set_result(None)


router = APIRouter(
    prefix="/v1/meals", tags=["meals"], responses=problem_responses(401, 404, 409, 422)
)

# statuses that no worker changes
FINAL = frozenset({"estimated", "needs_review", "failed", "confirmed"})
MAX_WAIT_SECONDS = 60

ARTEFACT_RESPONSES: Responses = {
    200: {
        "content": {"image/jpeg": {}, "application/json": {}, "application/octet-stream": {}},
        "description": "The picture, the points, or the scene (docs/volume.md).",
    },
}
PROBLEMS = problem_responses(403, 410)
RETRY_RESPONSES: Responses = {
    200: {"model": MealOut, "description": "It waits for its estimate already: nothing changed."},
    202: {"model": MealOut, "description": "Queued again; Location names the meal."},
    **PROBLEMS,
}


@router.get(
    "/{meal_id}",
    response_model=MealOut,
    responses={304: {"description": "The caller has this version."}},
)
async def get_meal(
    request: Request,
    meal_id: MealId,
    state: State,
    caller: CurrentCaller,
    wait: Annotated[
        float,
        Query(ge=0, le=MAX_WAIT_SECONDS, description="Wait up to so many seconds for a change."),
    ] = 0,
    participant: OfWhichParticipant = None,
) -> Response:
    """How a meal stands: what has arrived, its status and, once estimated, its foods: volumes, mass, nutrients.

    With `wait` the answer comes when its status or stage, or its after-meal pair's, changes, or when the time is up.
    With `If-None-Match` it also comes at once if the meal is no longer at that ETag.
    """
    view = await anyio.to_thread.run_sync(read_meal, state.database, caller, meal_id, participant)
    etags = request.headers.get("if-none-match")
    if wait and will_change(view) and (etags is None or is_held(etags, meal_etag(view))):
        await state.part(MealWaiter).wait(view.meal.id, view.meal.version, wait)
        view = await anyio.to_thread.run_sync(
            read_meal, state.database, caller, meal_id, participant
        )
    if etags is not None and is_held(etags, meal_etag(view)):
        return Response(status_code=304, headers={"ETag": meal_etag(view)})
    return tagged_meal(view)


@router.get(
    "/{meal_id}/artefacts/{name}", response_class=StreamingResponse, responses=ARTEFACT_RESPONSES
)
def get_artefact(
    meal_id: MealId,
    name: Annotated[
        str, Path(max_length=64, description="The artefact's name, as the run lists it.")
    ],
    state: State,
    caller: CurrentCaller,
    participant: OfWhichParticipant = None,
    pair: Annotated[
        Literal["meal", "after"], Query(description="Of the run on which pair.")
    ] = "meal",
) -> StreamingResponse:
    """A picture, the point cloud or the scene of the last run on the meal's pair, or on its after-meal pair."""
    artefact, content = open_artefact(
        state.database, state.blobs, caller, meal_id, name, participant, pair
    )
    return ClosingStream(
        content,
        content.close,
        media_type=artefact.media_type,
        headers={
            "Content-Length": str(artefact.bytes),
            "ETag": f'"{artefact.sha256}"',
            "Cache-Control": "private, max-age=86400, immutable",
        },
    )


@router.post("/{meal_id}/cancel", response_model=MealOut, responses=PROBLEMS)
def post_cancel(
    meal_id: MealId, state: State, caller: CurrentCaller, participant: OfWhichParticipant = None
) -> ModelResponse:
    """Cancel the estimate of a meal, or of its after-meal pair, that is not made yet.

    Its status becomes `failed` with the code `cancelled`; its photographs are kept. Repeated, it gives the same answer.
    """
    return tagged_meal(cancel_meal(state.database, caller, meal_id, participant))


@router.post("/{meal_id}/retry", status_code=202, response_model=MealOut, responses=RETRY_RESPONSES)
def post_retry(
    meal_id: MealId, state: State, caller: CurrentStaff, participant: OfWhichParticipant = None
) -> ModelResponse:
    """Have a meal, or its after-meal pair, that failed estimated again. Calls at the same time queue it once."""
    view, is_new = retry_meal(state.database, state.part(JobQueue), caller, meal_id, participant)
    return tagged_meal(view, 202 if is_new else 200, is_located=is_new)


def will_change(view: MealView) -> bool:
    """Whether a worker will change the meal, its after-meal pair or an item, or photographs of the meal are missing."""
    is_remeasured = any(REMEASURING in item.record.flags for item in view.items)
    return view.meal.status not in FINAL or view.meal.after_status in WAITING or is_remeasured
