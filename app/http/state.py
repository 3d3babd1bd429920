"""What the endpoints of one process share; app/main.py makes it, app/people/access/deps.py hands it out."""

from collections.abc import Iterable
from typing import TypeVar

import anyio

from app.core.settings import Settings
from app.db.session import Database
from app.storage.blob_store import BlobStore

# in a request's state, by app/cli/serving.py: a function that resets the connection
CUT = "cut_connection"

Part = TypeVar("Part")


class ApiState:
    """Settings, database and blob store of a process, and its other parts by their type.

    A domain asks for a part by its class (`state.part(Eraser)`), so that this module need not
    import any domain.
    """

    def __init__(
        self, settings: Settings, database: Database, blobs: BlobStore, parts: Iterable[object]
    ) -> None:
        self.settings = settings
        self.database = database
        self.blobs = blobs
        self.upload_limiter = anyio.CapacityLimiter(settings.max_uploads)
        self._parts = {type(part): part for part in parts}

    def part(self, kind: type[Part]) -> Part:
        """The part of this type. Raises KeyError if the process has none."""
        part = self._parts[kind]
        assert isinstance(part, kind)  # noqa: S101  # for the type checker: kept by its own type
        return part
