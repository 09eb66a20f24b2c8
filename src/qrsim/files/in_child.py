"""Runs functions in a child process with limits of memory and time: a decoder that crashes ends only the child."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Mapping
from typing import TypeVar

from qrsim.errors import UsageError

T = TypeVar("T")
# Address space that a child may take beyond that of its imports [bytes], and the longest time of a call [s].
MEMORY, LONGEST_S = 2**30, 120.0
# Seconds in which a child that has closed its pipe ends, and messages of one error that come back.
LAST_S, MOST_REASONS = 5.0, 10
_BLAS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class ChildError(Exception):
    """A child has no result; the message gives the reason.

    Attributes:
        reasons: type and message of the error that the function raised, then of those that led to it; empty if the
            child crashed, ran out of memory, or took too long.
    """

    def __init__(self, message: str, reasons: tuple[str, ...] = ()):
        super().__init__(message)
        self.reasons = reasons


class Child:
    """A process that calls functions, started by the first call and ended by ``with``.

    A function is found there by the name of its module, which should be quick to import. Arguments and results travel
    by pickle. After an error without ``reasons`` the next call starts another process. Windows has no limit of memory.

    Args:
        memory: address space that it may take beyond that of its imports [bytes].
        seconds: longest time of a call [s].
        settings: variables of its environment.
    """

    def __init__(self, memory: int = MEMORY, seconds: float = LONGEST_S, settings: Mapping[str, str] | None = None):
        self._memory, self._seconds, self._settings = memory, seconds, settings or {}
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *_: object) -> None:
        self._end(0.0)

    @property
    def number(self) -> int | None:
        """Process id of the child process; None if it does not run."""
        return self._process.pid if self._process else None

    def call(self, function: Callable[..., T], *arguments: object) -> T:
        """Call a module-level function in the child process, and return its result; its UsageErrors are raised here
        again.

        Raises:
            UsageError: the function raised one; the message is the same.
            ChildError: the child crashed, raised another error, ran out of memory, or took too long.
        """
        job = pickle.dumps((function, arguments), pickle.HIGHEST_PROTOCOL)
        process, late = self._running(), threading.Event()

        def end() -> None:
            """Kill the child process, which takes too long."""
            late.set()
            process.kill()

        assert process.stdin is not None
        assert process.stdout is not None
        alarm = threading.Timer(self._seconds, end)
        alarm.daemon = True
        alarm.start()
        try:
            process.stdin.write(job)
            process.stdin.flush()
            kind, value = pickle.load(process.stdout)
        except Exception:  # broken pipes and partial answers
            code = self._end(LAST_S)
            raise ChildError(
                f"it takes longer than {self._seconds:g} s" if late.is_set() else _how_it_ended(code)
            ) from None
        except BaseException:
            # Its answer would be taken for that of the next call.
            self._end(0.0)
            raise
        finally:
            alarm.cancel()
        if kind == "usage":
            raise UsageError(value)
        if kind == "memory":
            self._end(0.0)
            raise ChildError(f"it needs more than {self._memory / 2**30:.3g} GB of memory")
        if kind == "error":
            message = value[0].partition(": ")[2].strip().partition("\n")[0] or value[0].partition(":")[0]
            raise ChildError(f"{message:.200}", value)
        found: T = value
        return found

    def _running(self) -> subprocess.Popen[bytes]:
        """Return the child process; it is started on first use."""
        if self._process is None:
            # Only an absolute path leads a child to the same modules from any folder.
            paths = os.pathsep.join(os.path.abspath(path) for path in sys.path if path)
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__, str(self._memory)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **dict.fromkeys(_BLAS, "1"), **self._settings, "PYTHONPATH": paths},
            )
        return self._process

    def _end(self, patience_s: float) -> int:
        """End the child process, by force after ``patience_s`` seconds, and return its exit code."""
        process, self._process = self._process, None
        if process is None:
            return 0
        try:
            process.wait(patience_s)
        except subprocess.TimeoutExpired:
            process.kill()
        process.communicate()
        return process.returncode


def in_child(function: Callable[..., T], *arguments: object, memory: int = MEMORY, seconds: float = LONGEST_S) -> T:
    """Call a function in a new child process, with limits on memory [bytes] and time [s], and return its result; errors
    are those of ``Child``."""
    with Child(memory, seconds) as child:
        return child.call(function, *arguments)


def _how_it_ended(code: int) -> str:
    """Return how a child process ended, from its exit code, as text for messages."""
    if code >= 0:
        return f"its decoder ended with code {code}"
    try:
        return f"its decoder crashed ({signal.Signals(-code).name})"
    except ValueError:
        return f"its decoder crashed (signal {-code})"


def _limit_memory(memory: int) -> None:
    """Limit the memory of this process to ``memory`` [bytes] more than it uses now, if the operating system can."""
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


def _answer(function: Callable[..., object], arguments: tuple[object, ...]) -> bytes:
    """Call a function in the child process; return its result or error, pickled as (kind, content), for the parent."""
    answer: tuple[str, object]
    try:
        return pickle.dumps(("value", function(*arguments)), pickle.HIGHEST_PROTOCOL)
    except UsageError as error:
        answer = "usage", str(error)
    except MemoryError:
        answer = "memory", None
    except Exception as error:  # whatever a decoder makes of a file goes back as text
        answer = "error", _reasons(error)
    return pickle.dumps(answer)


def _reasons(error: BaseException | None) -> tuple[str, ...]:
    """Return type and message of an error and of each of its causes, as texts, outermost first."""
    found: list[str] = []
    while error is not None and len(found) < MOST_REASONS:
        found.append(f"{type(error).__name__}: {error}")
        error = error.__cause__ or error.__context__
    return tuple(found)


def _main(memory: int) -> None:
    # Libraries in C print; the results have a pipe for themselves.
    """Execute the calls that arrive on standard input, until it ends: the main loop of the child process."""
    results = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    warnings.simplefilter("ignore")
    limited = False
    while True:
        try:
            function, arguments = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        if not limited:
            # After the imports of the first function.
            _limit_memory(memory)
            limited = True
        results.write(_answer(function, arguments))
        results.flush()


if __name__ == "__main__":
    _main(int(sys.argv[1]))
