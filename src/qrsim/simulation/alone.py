"""Methods that only one thread at a time may execute."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

from qrsim.errors import BusyError


class Alone:
    """Base of objects that one thread at a time may change while others read.

    Readers wait for ``_lock``. A writer holds it too and sets ``_changes``, so that a second writer raises an error
    instead of waiting: with two threads that fly one simulation, the order of steps would differ in every run.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._changes = False

    def _wait_or_refuse(self, what: str) -> None:
        """Acquire the object's lock after a thread that only reads; raises BusyError, naming the method ``what``, after
        one that writes.

        Raises:
            BusyError: the other thread is changing the object.
        """
        if self._changes:
            raise BusyError(
                f"{what}: another thread is flying this simulation; give each thread its own, or let one wait for the "
                "other (threading.Lock)"
            )
        self._lock.acquire()


S = TypeVar("S", bound=Alone)
P = ParamSpec("P")
R = TypeVar("R")


def alone(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Let only one thread at a time run the decorated method of an object, because it changes the object's state; see
    ``Alone``."""

    @wraps(method)
    def called(self: S, /, *arguments: P.args, **named: P.kwargs) -> R:
        """Call the method, and return its result, while no other thread runs a decorated method of this object."""
        if not self._lock.acquire(False):
            self._wait_or_refuse(method.__name__)
        self._changes = True
        try:
            return method(self, *arguments, **named)
        finally:
            self._changes = False
            self._lock.release()

    return called
