"""`?wait=`: one poller per process queries the database for all meals that requests wait for.

A waiting request holds a future, but neither a thread nor a connection.
"""

import asyncio
import contextlib
import uuid
from collections.abc import Collection

import anyio.to_thread
import sqlalchemy.exc
import structlog

from app.db.session import Database
from app.meals.stored import queries as meals

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
            except (
                sqlalchemy.exc.SQLAlchemyError
            ):  # without a database, requests wait until their time is over
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
