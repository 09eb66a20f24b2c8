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
        """Print a line soon; where a thousand wait already, it is left out."""
        with suppress(queue.Full):
            self._lines.put_nowait(line)

    def close(self) -> None:
        """Wait a moment for the lines to be read."""
        with suppress(queue.Full):
            self._lines.put(None, timeout=1.0)
            self._thread.join(1.0)

    def _print(self) -> None:
        """Write the waiting lines until the end; the body of the thread."""
        with suppress(OSError):  # nobody reads any more
            while (line := self._lines.get()) is not None:
                left = f"{line}\n".encode()
                while left:
                    left = left[os.write(self._descriptor, left) :]
