"""What is not compiled here, and how that is said."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class UnsupportedError(Exception):
    """A program that this code generator cannot compile; XLA can.

    Args:
        reason: what it is about the program.
        place: the line of the program, where it is known.
    """

    def __init__(self, reason: str, place: str = ""):
        super().__init__(f"{reason} at {place}" if place else reason)
        self.reason, self.place = reason, place

    def at(self, place: str) -> UnsupportedError:
        """Return the error with a place in the user's source added, unless it has one."""
        return self if self.place else UnsupportedError(self.reason, place)

    def again(self) -> UnsupportedError:
        """Return a copy of the error without traceback, because its frames would keep a user's policy alive."""
        return UnsupportedError(self.reason, self.place)


@contextmanager
def refusing() -> Iterator[None]:
    """Context manager: turn any exception inside into an UnsupportedError.

    Raises:
        UnsupportedError: in place of any other error but a lack of memory.
    """
    try:
        yield
    # Too little memory would be too little for XLA too.
    except (UnsupportedError, MemoryError):
        raise
    # A fault of ours must not cost a user the flight: XLA computes it, and the warning names the fault.
    except Exception as error:
        text = " ".join(str(error).split())
        raise UnsupportedError(
            f"an error of the code generator itself ({type(error).__name__}: {text[:200]})"
        ) from error
