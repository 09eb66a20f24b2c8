"""A slow link on this machine: a proxy that lets so many bits a second through, and holds little."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Iterator

# What is on its way at a time, in the proxy and in each of its sockets [bytes].
PIECE = 4096


@contextlib.contextmanager
def slow_link(address: str, bits_per_second: float) -> Iterator[str]:
    """Return the address of a proxy of a page, slow towards the browser."""
    host, _, port = address.removeprefix("http://").rpartition(":")
    loop, started, ended = asyncio.new_event_loop(), threading.Event(), asyncio.Event()
    found: list[int] = []

    async def pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, slow: bool) -> None:
        free = loop.time()
        with contextlib.suppress(OSError):
            while data := await reader.read(PIECE):
                if slow:
                    free = max(free, loop.time()) + 8.0 * len(data) / bits_per_second
                    await asyncio.sleep(free - loop.time())
                writer.write(data)
                await writer.drain()
        writer.close()

    async def through(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        inner, outer = await asyncio.open_connection(host, int(port), limit=PIECE)
        writer.transport.set_write_buffer_limits(PIECE)
        await asyncio.gather(pump(inner, writer, True), pump(reader, outer, False))

    async def serve() -> None:
        async with await asyncio.start_server(through, "127.0.0.1", 0) as server:
            found.append(server.sockets[0].getsockname()[1])
            started.set()
            await ended.wait()

    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()), daemon=True)
    thread.start()
    started.wait()
    try:
        yield f"http://127.0.0.1:{found[0]}"
    finally:
        loop.call_soon_threadsafe(ended.set)
        thread.join(5.0)
