"""A line between a browser and a server on this machine: so many milliseconds there and back, so many bits a second."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

CHUNK = 16 << 10


@contextmanager
def slow_line(port: int, milliseconds: float = 100.0, megabits: float = 20.0) -> Iterator[int]:
    """The port of a proxy to ``port``: half of the delay each way, and one speed for all that comes from the server."""
    loop = asyncio.new_event_loop()
    ready, found, servers, serving = threading.Event(), [], [], []

    async def serve() -> None:
        down = _Pipe(milliseconds / 2000, 1e6 * megabits / 8)

        async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            there, back = await asyncio.open_connection("127.0.0.1", port)
            up = _Pipe(milliseconds / 2000, 1e6 * megabits / 8)
            with suppress(asyncio.CancelledError):  # the end of the measurement
                await asyncio.gather(up.carry(reader, back), down.carry(there, writer), return_exceptions=True)

        server = await asyncio.start_server(connected, "127.0.0.1", 0)
        servers.append(server)
        serving.append(asyncio.current_task())
        found.append(server.sockets[0].getsockname()[1])
        ready.set()
        await server.serve_forever()

    def run() -> None:
        asyncio.set_event_loop(loop)
        task = loop.create_task(serve())
        with suppress(asyncio.CancelledError):
            loop.run_until_complete(task)
        left = asyncio.all_tasks(loop)
        for one in left:
            one.cancel()
        loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
        loop.close()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    if not ready.wait(30):
        raise RuntimeError("the proxy did not start")
    try:
        yield found[0]
    finally:
        loop.call_soon_threadsafe(lambda: [server.close() for server in servers] + [task.cancel() for task in serving])
        thread.join(10)


class _Pipe:
    """One direction: what is read arrives after a delay, and not before what came earlier has been carried."""

    def __init__(self, delay: float, bytes_per_second: float) -> None:
        self.delay, self.speed, self.free = delay, bytes_per_second, 0.0

    async def carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Until the reader ends. What waits is limited, as in a line's buffers."""
        queue: asyncio.Queue = asyncio.Queue(maxsize=32)
        clock = asyncio.get_running_loop().time

        async def send() -> None:
            with suppress(ConnectionError):
                while (item := await queue.get()) is not None:
                    arrives, data = item
                    await asyncio.sleep(max(arrives - clock(), 0))
                    writer.write(data)
                    await writer.drain()
            writer.close()

        sending = asyncio.create_task(send())
        with suppress(ConnectionError):
            while not sending.done() and (data := await reader.read(CHUNK)):
                self.free = max(self.free, clock()) + len(data) / self.speed
                await queue.put((self.free + self.delay, data))
        if not sending.done():
            await queue.put(None)
        await sending
