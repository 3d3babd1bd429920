"""A streamed answer that gives back what it holds open at its end, also when the caller hangs up in its midst.

Starlette leaves a source that it did not read to the end to the garbage collector, which may come to it hours later:
until then it holds what it has open, such as a file without a name with all photographs of a person.
"""

from collections.abc import Callable, Iterator, Mapping

import anyio
from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send


class ClosingStream(StreamingResponse):
    """Streams bytes; calls `close` once, whatever happens."""

    def __init__(
        self,
        source: Iterator[bytes],
        close: Callable[[], object],
        *,
        media_type: str,
        headers: Mapping[str, str],
        status_code: int = 200,
    ) -> None:
        super().__init__(source, status_code, media_type=media_type, headers=headers)
        self._close = close

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Stream, then close: in a thread, shielded from the cancellation that a caller who left causes."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            with anyio.CancelScope(shield=True):
                await anyio.to_thread.run_sync(self._close)
