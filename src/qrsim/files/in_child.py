"""Runs a function in a child process with limits of memory and time: a decoder that crashes ends only the child."""

from __future__ import annotations

import importlib
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import Any, TypeVar

from qrsim.errors import UsageError

T = TypeVar("T")
# Address space that a child may take beyond that of its imports [bytes], and its longest life [s].
MEMORY, LONGEST_S = 2**30, 120.0
_BLAS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class ChildError(Exception):
    """A child ended without a result; the message says why, in some words."""


def in_child(function: Callable[..., T], *arguments: object, memory: int = MEMORY, seconds: float = LONGEST_S) -> T:
    """Return the result of a function that runs in a child process.

    The function is found there by its name, so that it has to be one of a module. Its module should be quick to import.
    Arguments and result travel by pickle. Windows has no limit of memory.

    Args:
        function: of a module.
        *arguments: of the function.
        memory: address space that it may take [bytes].
        seconds: longest time that it may take [s].

    Raises:
        UsageError: the function raised one; the message is the same.
        ChildError: the child crashed, raised another error, ran out of memory, or took too long.
    """
    job = pickle.dumps((function.__module__, function.__qualname__, arguments, memory))
    # Only an absolute path leads a child to the same modules from any folder.
    paths = os.pathsep.join(os.path.abspath(path) for path in sys.path if path)
    environment = {**os.environ, **dict.fromkeys(_BLAS, "1"), "PYTHONPATH": paths}
    try:
        ended = subprocess.run(
            [sys.executable, "-P", "-m", __name__], input=job, capture_output=True, timeout=seconds, env=environment
        )
    except subprocess.TimeoutExpired:
        raise ChildError(f"it takes longer than {seconds:g} s") from None
    try:
        kind, value = pickle.loads(ended.stdout)
    except Exception:
        raise ChildError(_how_it_ended(ended.returncode)) from None
    if kind == "usage":
        raise UsageError(value)
    if kind == "error":
        raise ChildError(value)
    return value


def _how_it_ended(code: int) -> str:
    """Return how the child ended, in words: its exit code or its signal."""
    if code >= 0:
        return f"its decoder ended with code {code}"
    try:
        return f"its decoder crashed ({signal.Signals(-code).name})"
    except ValueError:
        return f"its decoder crashed (signal {-code})"


def _limit_memory(memory: int) -> None:
    """Let this process take some more bytes of memory at most, where the system can limit it."""
    try:
        import resource
    except ImportError:  # Windows
        return
    try:
        with open("/proc/self/statm", "rb") as file:
            taken = int(file.read().split()[0]) * resource.getpagesize()
    except OSError:
        taken = 0
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    wanted = taken + memory
    try:
        resource.setrlimit(resource.RLIMIT_AS, (wanted if most == resource.RLIM_INFINITY else min(wanted, most), most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (OSError, ValueError):
        # Some systems know the limit and refuse it.
        return


def _result_of(job: bytes) -> tuple[str, Any]:
    """Run a pickled job; return "value" and its result, or "usage" or "error" and the words."""
    module, name, arguments, memory = pickle.loads(job)
    function: Any = importlib.import_module(module)
    for part in name.split("."):
        function = getattr(function, part)
    _limit_memory(memory)
    try:
        return "value", function(*arguments)
    except UsageError as error:
        return "usage", str(error)
    except MemoryError:
        return "error", f"it needs more than {memory / 2**30:.3g} GB of memory"
    except Exception as error:
        words = (str(error).strip().splitlines() or [type(error).__name__])[0]
        return "error", f"{words:.200}"


def _main() -> None:
    """Read a job from standard input and write its pickled answer to standard output."""
    # Libraries in C print; the result has a pipe for itself.
    result = os.dup(1)
    os.dup2(2, 1)
    answer = pickle.dumps(_result_of(sys.stdin.buffer.read()))
    with os.fdopen(result, "wb") as file:
        file.write(answer)


if __name__ == "__main__":
    _main()
