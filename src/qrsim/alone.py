"""Methods that only one thread may be in at a time."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

from qrsim.errors import BusyError


class _Flown(Protocol):
    _flying: Any


S = TypeVar("S", bound=_Flown)
P = ParamSpec("P")
R = TypeVar("R")


def alone(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Let one thread at a time call a method, and those that it calls; its object has a lock ``_flying``.

    A thread that comes while another is inside does not wait, because whoever flies one simulation from two threads
    gets another flight each time: it is told.
    """

    @wraps(method)
    def called(self: S, /, *arguments: P.args, **named: P.kwargs) -> R:
        if not self._flying.acquire(blocking=False):
            raise BusyError(
                f"{method.__name__}: another thread is flying this simulation; give each thread its own, or let one "
                "wait for the other (threading.Lock)"
            )
        try:
            return method(self, *arguments, **named)
        finally:
            self._flying.release()

    return called
