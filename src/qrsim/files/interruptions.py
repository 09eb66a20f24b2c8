"""Ctrl-C and SIGTERM: both end a command in an orderly way, and neither is lost.

A signal becomes an exception in the middle of whatever the program does. Where that is a callback of the garbage
collector (JAX has one), a destructor or a callback of a library in C, the exception is dropped and the program goes on.
So an exception that dies before the command line has taken it sends its signal again. Where it would end the process
or corrupt it (in what hands memory to LLVM, while a module in C is imported, inside of JAX for some seconds), none is
raised: the signal is sent again a little later.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from importlib.machinery import ExtensionFileLoader
from types import FrameType
from typing import Any

# What it is called, and the exit code; the latter as shells have it.
WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
AGAIN_AFTER_S = 0.02
# Modules in the middle of which nothing is raised, and those that are given some seconds to finish.
FRAGILE = ("llvmlite.", "qrsim.engine.llvm.compiler", "ctypes")
DELICATE = ("jax.", "jaxlib.")
PATIENCE_S = 3.0
# A signal so soon after one that was raised waits: it would interrupt the blocks that save the work of the first.
APART_S = 0.25
# The last signal that came, the context that hears it (None: nobody does), the times [s] when one began to wait and
# when one was raised, and whether it is to be sent again.
_state: dict[str, Any] = {"number": None, "listener": None, "since": None, "raised": None, "waiting": False}
_sending = threading.Lock()


class Interruption(KeyboardInterrupt):
    """Request by the user or the system to end the program.

    Attributes:
        number: of the signal.
    """

    def __init__(self, number: int = signal.SIGINT):
        super().__init__()
        self.number = signal.Signals(number)
        self._listener = _state["listener"]

    def __del__(self) -> None:
        # Nobody holds it any more: if nobody took it either, somebody dropped it. One that an earlier context took
        # may die of old age during a later one.
        if self._listener is not None and _state["listener"] is self._listener:
            _send_again(self.number)


def word(error: BaseException) -> str:
    """Return the word for messages about a stopped program: "interrupted" for Ctrl-C, "terminated" for SIGTERM."""
    return WORDS[getattr(error, "number", signal.SIGINT)]


def exit_code(error: BaseException) -> int:
    """Return the exit code of a program ended by this error: 130 for Ctrl-C, 143 for SIGTERM."""
    return 128 + int(getattr(error, "number", signal.SIGINT))


def received() -> Interruption | None:
    """Return an Interruption for the last signal received since ``heard`` began; None without one."""
    return None if _state["number"] is None else Interruption(_state["number"])


@contextlib.contextmanager
def heard() -> Iterator[None]:
    """In the context, raise an Interruption on Ctrl-C and SIGTERM, in the main thread only; ignored signals stay
    ignored."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = _installed(_raise)
    hook = sys.unraisablehook

    def quiet(dropped: sys.UnraisableHookArgs) -> None:
        """Report an exception that Python cannot raise, such as one in a destructor, unless it is an Interruption."""
        # Its destructor sends the signal again, and there is nothing to report.
        if not (dropped.exc_type is not None and issubclass(dropped.exc_type, Interruption)):
            hook(dropped)

    _state.update(number=None, listener=object(), since=None, raised=None, waiting=False)
    sys.unraisablehook = quiet
    try:
        yield
    finally:
        _state["listener"] = None
        # What is being sent comes while these handlers still stand: it is not for those of whoever comes next.
        with _sending:
            pass
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def calling(do: Callable[[], None]) -> Iterator[None]:
    """In the context, call ``do`` on Ctrl-C and SIGTERM; if a signal came, raise an Interruption at the end."""
    came: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        """Note the signal, and call ``do``."""
        came.append(number)
        do()

    with _handling(handle):
        yield
    if came:
        raise Interruption(came[0])


def run_until_signal(main: Coroutine[object, object, None]) -> None:
    """Run a coroutine as ``asyncio.run`` does; Ctrl-C and SIGTERM cancel it, and raise an Interruption after it has
    ended.

    An exception in the middle of the event loop could lose the wake-up of a task, which would then wait forever. So a
    signal raises one, as in ``heard``, only if the coroutine has not ended some seconds later.
    """
    import asyncio

    came: list[int] = []
    late: list[threading.Timer] = []

    async def watched() -> None:
        """Run the main coroutine as a task, which a signal cancels."""
        loop, task = asyncio.get_running_loop(), asyncio.current_task()
        assert task is not None

        def handle(number: int, frame: FrameType | None) -> None:
            """Cancel the task at the first signal; raise an Interruption at the second, or if the task does not end in
            time."""
            if came:
                _raise(number, frame)
                return
            came.append(number)
            loop.call_soon_threadsafe(task.cancel)
            late.append(threading.Timer(PATIENCE_S, _send, (number, _state["listener"])))
            late[0].daemon = True
            late[0].start()

        with _handling(handle):
            await main

    try:
        asyncio.run(watched())
    except asyncio.CancelledError:
        if not came:
            raise
    finally:
        for timer in late:
            timer.cancel()
    if came:
        raise Interruption(came[0])


@contextlib.contextmanager
def ending() -> Iterator[threading.Event]:
    """In the context, only set the yielded event on Ctrl-C and SIGTERM, because the work itself is already done."""
    came = threading.Event()
    with _handling(lambda number, frame: came.set()):
        yield came


def leave_at_once() -> None:
    """From now on, end the process without a traceback on Ctrl-C and SIGTERM, until ``heard`` begins."""

    def leave(number: int, frame: FrameType | None) -> None:
        """Print the word for a signal, and end the process."""
        with contextlib.suppress(OSError):
            os.write(2, f"{WORDS[signal.Signals(number)]}\n".encode())
        os._exit(128 + number)

    _installed(leave)


@contextlib.contextmanager
def _handling(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """In the context, call ``handler`` on Ctrl-C and SIGTERM; in threads other than the main one, do nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = _installed(handler)
    try:
        yield
    finally:
        for number, handler_before in before.items():
            signal.signal(number, handler_before)


def _installed(handler: Any) -> dict[int, Any]:
    """Install a handler of Ctrl-C and SIGTERM, except where they are ignored; return signal number -> previous
    handler."""
    before: dict[int, object] = {int(number): signal.getsignal(number) for number in WORDS}
    heeded = {number: now for number, now in before.items() if now not in (signal.SIG_IGN, None)}
    for number in heeded:
        signal.signal(number, handler)
    return heeded


def _raise(number: int, frame: FrameType | None) -> None:
    """Raise an Interruption for a signal; if the running code must not be interrupted, send the signal again later."""
    if _state["listener"] is None:
        return  # its work is done
    now = time.monotonic()
    _state["number"] = number
    _state["since"] = _state["since"] or now
    names = FRAGILE if now - _state["since"] > PATIENCE_S else (*FRAGILE, *DELICATE)
    if _is_inside(frame, names) or now - (_state["raised"] or -APART_S) < APART_S:
        _send_again(number)
        return
    _state.update(since=None, raised=now)
    raise Interruption(number)


def _is_inside(frame: FrameType | None, names: tuple[str, ...]) -> bool:
    """Return whether the call stack is inside a module in ``names`` or an import by C code, which must not be
    interrupted."""
    while frame is not None:
        if frame.f_globals.get("__name__", "").startswith(names):
            return True
        # A module in C that is being imported.
        if frame.f_code in _LOADING:
            return True
        frame = frame.f_back
    return False


_LOADING = (ExtensionFileLoader.exec_module.__code__, ExtensionFileLoader.create_module.__code__)


def _send_again(number: int) -> None:
    """Send the signal to this process again after AGAIN_AFTER_S [s], unless that is already planned."""
    if _state["waiting"]:
        return
    _state["waiting"] = True
    again = threading.Timer(AGAIN_AFTER_S, _send, (number, _state["listener"]))
    again.daemon = True
    again.start()


def _send(number: int, listener: object) -> None:
    """Send the signal to the main thread, unless the context that ``listener`` stands for has ended."""
    with _sending:
        if _state["listener"] is not listener:
            return
        _state["waiting"] = False
        if hasattr(signal, "pthread_kill"):
            # To the thread that handles it, which may be waiting for something.
            signal.pthread_kill(threading.main_thread().ident or 0, number)
        else:
            signal.raise_signal(number)
