"""Lines of a server for its operator."""

from __future__ import annotations

import os
import queue
import threading
from contextlib import suppress

MOST_LINES, STANDARD_OUTPUT = 1000, 1


class Log:
    """Prints lines from a thread of its own: whoever does not read them must not hold the server up, nor its end.

    Args:
        descriptor: of the open file to print to, by default standard output.
    """

    def __init__(self, descriptor: int = STANDARD_OUTPUT) -> None:
        self._descriptor = descriptor
        self._lines: queue.Queue[str | None] = queue.Queue(MOST_LINES)
        self._thread = threading.Thread(target=self._print, daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
        """Queue a line for the printing thread; it is dropped if the queue is full."""
        with suppress(queue.Full):
            self._lines.put_nowait(line)

    def close(self) -> None:
        """Print the queued lines, waiting at most about 2 s, and end the thread."""
        with suppress(queue.Full):
            self._lines.put(None, timeout=1.0)
            self._thread.join(1.0)

    def _print(self) -> None:
        """Print queued lines until ``close`` is called, in the log's own thread."""
        with suppress(OSError):  # nobody reads any more
            while (line := self._lines.get()) is not None:
                left = f"{line}\n".encode()
                while left:
                    left = left[os.write(self._descriptor, left) :]
