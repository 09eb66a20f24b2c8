"""What a browser fetches from a page, without a browser: a process that prints what it got when its input ends."""

from __future__ import annotations

import contextlib
import json
import sys
import threading
import time
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

import msgspec
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

BODIES = "/world/vehicles/bodies"


def messages(window: bytes) -> Iterator[dict[str, Any]]:
    """Yield the messages of a window: lengths, compressed messages, arrays."""
    size = int.from_bytes(window[8:16], "little")
    content = zstandard.ZstdDecompressor().decompress(window[16 : 16 + size])
    yield from msgspec.msgpack.decode(content)["messages"]


def composed(window: bytes) -> float:
    """Return when the server made a window, by its performance counter [s]."""
    size = int.from_bytes(window[8:16], "little")
    found: float = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(window[16 : 16 + size]))[
        "timestampSec"
    ]
    return found


def main() -> None:
    """Fetch from the address given until the input ends or the page goes away."""
    address = sys.argv[1].replace("http", "ws")
    protocol: Any = f"viser-v{version('viser')}"
    begun, size, windows, whole_s = time.perf_counter(), 0, 0, None
    lag_s: float | None = None
    found = set()
    with connect(address, subprotocols=[protocol], max_size=None, proxy=None) as connection:
        threading.Thread(target=lambda: (sys.stdin.read(), connection.close()), daemon=True).start()
        with contextlib.suppress(ConnectionClosed):
            for window in connection:
                assert isinstance(window, bytes)
                size, windows = size + len(window), windows + 1
                if whole_s is not None:
                    # How old is what has just arrived, by the clock that all processes share; the scene itself aside.
                    if (made := composed(window)) > begun + whole_s:
                        lag_s = max(lag_s or 0.0, time.perf_counter() - made)
                    continue
                for message in messages(window):
                    if message.get("name") == BODIES:
                        found |= {"made"} if "props" in message else set(message.get("updates", ()))
                if found >= {"made", "batched_positions", "batched_wxyzs"}:
                    whole_s = time.perf_counter() - begun
    seconds = time.perf_counter() - begun
    print(json.dumps({"bytes": size, "windows": windows, "seconds": seconds, "whole_s": whole_s, "lag_s": lag_s}))


if __name__ == "__main__":
    main()
