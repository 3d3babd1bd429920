"""A TCP proxy that can be told to misbehave: between phone and API, and between our processes and database or store."""

import asyncio
import contextlib
import threading

PIECE = 65536


class Network:
    """The event loop of all proxies, in a thread."""

    def __init__(self):
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="proxies", daemon=True)
        self._thread.start()
        self._links = []

    def link(self, name, port):
        """A proxy before a port of this machine; its own port is `port` of what comes back."""
        link = Link(name, port, self._loop)
        self.run(link.open())
        self._links.append(link)
        return link

    def run(self, work):
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(30)

    def close(self):
        for link in self._links:
            self.run(link.close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10)
        self._loop.close()


class Link:
    """One proxy. Its faults are set from other threads; they hold for open connections too.

    is_stalled: nothing goes on, nothing is lost. loses_answers: what is asked arrives,
    what is answered does not. is_refusing: new connections are ended at once.
    """

    def __init__(self, name, target_port, loop):
        self.name = name
        self.port = None
        self.is_stalled = False
        self.loses_answers = False
        self.is_refusing = False
        self._target_port = target_port
        self._loop = loop
        self._writers = set()
        self._tasks = set()

    async def open(self):
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]

    def cut(self):
        """Reset every open connection."""
        self._loop.call_soon_threadsafe(self._abort_all)

    def half_close(self):
        """End the way back of every open connection; what is asked still arrives."""

        def end():
            for writer in list(self._writers):
                with contextlib.suppress(OSError, RuntimeError, NotImplementedError):
                    if writer.is_towards_caller:
                        writer.stream.write_eof()

        self._loop.call_soon_threadsafe(end)

    def heal(self):
        self.is_stalled = self.loses_answers = self.is_refusing = False

    async def close(self):
        self._server.close()
        self._abort_all()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _abort_all(self):
        for writer in list(self._writers):
            writer.stream.transport.abort()

    async def _serve(self, reader, writer):
        self._tasks.add(asyncio.current_task())
        asyncio.current_task().add_done_callback(self._tasks.discard)
        caller = _Writer(writer, is_towards_caller=True)
        if self.is_refusing:
            writer.transport.abort()
            return
        try:
            onward_reader, onward = await asyncio.open_connection("127.0.0.1", self._target_port)
        except OSError:
            writer.transport.abort()
            return
        target = _Writer(onward, is_towards_caller=False)
        self._writers |= {caller, target}
        try:
            await asyncio.gather(self._pump(reader, target), self._pump(onward_reader, caller))
        except (OSError, RuntimeError):  # cut, or half closed by us
            pass
        finally:
            self._writers -= {caller, target}
            writer.transport.abort()
            onward.transport.abort()

    async def _pump(self, reader, writer):
        while piece := await reader.read(PIECE):
            while self.is_stalled:  # noqa: ASYNC110  # set from other threads
                await asyncio.sleep(0.05)
            if writer.is_towards_caller and self.loses_answers:
                continue
            writer.stream.write(piece)
            await writer.stream.drain()
        if writer.stream.can_write_eof():
            writer.stream.write_eof()


class _Writer:
    def __init__(self, stream, *, is_towards_caller):
        self.stream = stream
        self.is_towards_caller = is_towards_caller
