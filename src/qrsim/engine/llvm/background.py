"""Better machine code of programs that already run on quick code, compiled by another process, one at a time.

The compiler holds a lock of llvmlite and the lock of Python while it works on a large module, so a thread would stop
the simulation. Code that does not arrive, because the process could not be started or was killed, is not missed: the
quick code computes the same bits.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import queue
import subprocess
import sys
import threading
import zlib
from collections.abc import Callable

from qrsim.engine.llvm import compiler

Request = tuple[bytes, Callable[[bytes], None]]
_REQUESTS: queue.SimpleQueue[Request] = queue.SimpleQueue()
_STARTING = threading.Lock()
_running: dict[str, threading.Thread | subprocess.Popen[bytes] | None] = {"thread": None, "process": None}


def compile_later(text: bytes, done: Callable[[bytes], None]) -> None:
    """Compile compressed LLVM text to faster machine code in a thread; call ``done`` with the object file.

    Args:
        text: of a module, compressed by ``packed``.
        done: is not called where there is no code.
    """
    with _STARTING:
        if _running["thread"] is None:
            thread = threading.Thread(target=_compile_requests, name="qrsim-compiler", daemon=True)
            thread.start()
            _running["thread"] = thread
    _REQUESTS.put((text, done))


def packed(text: str) -> bytes:
    """Compress the text of an LLVM module to bytes."""
    return zlib.compress(text.encode(), 1)


def unpacked(text: bytes) -> str:
    """Decompress the text of an LLVM module from bytes."""
    return zlib.decompress(text).decode()


def _compile_requests() -> None:
    """Compile the requested LLVM texts one after the other; runs in a thread."""
    while True:
        text, done = _REQUESTS.get()
        code = _compile_in_process(text)
        if code:
            done(code)


def _compile_in_process(text: bytes) -> bytes | None:
    """Compile compressed LLVM text in another process and return the object file; None if that fails."""
    # Without the folder of the script on the path, where modules have names as short as those of others.
    command = [sys.executable, "-P", str(compiler.__file__)]
    pipe = subprocess.PIPE
    try:
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL) as process:
            _running["process"] = process
            code, _ = process.communicate(unpacked(text).encode())
    except (OSError, zlib.error):
        return None
    finally:
        _running["process"] = None
    return code if process.returncode == 0 else None


@atexit.register
def _stop() -> None:
    """Stop background compilation at the exit of the process."""
    process = _running["process"]
    if isinstance(process, subprocess.Popen):
        with contextlib.suppress(OSError):
            process.kill()


def _forget() -> None:
    """Drop the threads and child processes of the parent; called in a child process after a fork."""
    global _REQUESTS, _STARTING
    _REQUESTS, _STARTING = queue.SimpleQueue(), threading.Lock()
    _running.update(thread=None, process=None)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
