"""Run tests on a copy of the package with one number changed.

This process imports what is slow to import, and never qrsim: each run is a fork of it, which puts a changed copy of the
package first on its path. So a mutant costs the import of qrsim and its tests, and nothing of one run is left in the
next.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest
from platformdirs import user_cache_path

from evidence._mutants import ROOT, SOURCE, Mutant, mutated

WARM = (
    "jax",
    "jax.numpy",
    "jax.scipy",
    "numpy",
    "scipy.optimize",
    "scipy.signal",
    "scipy.stats",
    "pydantic",
    "yaml",
    "xarray",
    "hypothesis",
)
KILLED, SURVIVED, TIMEOUT, NOTHING = "killed", "survivor", "timeout", "no tests"
# What a run may take: seconds of the processor and bytes; of the clock, this many times as long, for a busy machine.
LIMIT_S, LIMIT_BYTES, PATIENCE = 300, 12 * 2**30, 10.0
# Exit codes of pytest.
_PASSED, _FAILED, _INTERRUPTED, _INTERNAL, _USAGE, _NO_TESTS = 0, 1, 2, 3, 4, 5


class Outcome(NamedTuple):
    """What became of one run of tests.

    Attributes:
        result: KILLED, SURVIVED, TIMEOUT, or NOTHING where no such test is there.
        killer: the first test that failed, or the file that could not be collected; "" where none did.
        seconds: of the clock.
        entered: (file below src/, qualified name) of functions that were entered, where that was asked for.
    """

    result: str
    killer: str
    seconds: float
    entered: tuple[tuple[str, str], ...] = ()


class _Watch:
    """A plugin of pytest that keeps the first failure."""

    def __init__(self) -> None:
        self.killer = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.killer:
            self.killer = report.nodeid

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed and not self.killer:
            self.killer = report.nodeid


class Workshop:
    """A copy of the package, and forks that run tests on it. One process has one."""

    def __init__(self, folder: Path) -> None:
        assert "qrsim" not in sys.modules, "the warm process must not know the package"
        self.folder = folder
        self.source = folder / "src"
        shutil.copytree(SOURCE, self.source, ignore=shutil.ignore_patterns("__pycache__"))
        _environment(self.source)
        for name in WARM:
            with contextlib.suppress(ImportError):
                importlib.import_module(name)
        # Else collecting what is warm takes half of a run's time.
        gc.collect()
        gc.freeze()

    @contextlib.contextmanager
    def holding(self, mutant: Mutant | None) -> Iterator[None]:
        """Have the mutant in the copy; None: the package as it is."""
        if mutant is None:
            yield
            return
        file = mutant.literal.file
        (self.source / file).write_text(mutated((SOURCE / file).read_text("utf-8"), mutant), "utf-8")
        try:
            yield
        finally:
            # With its time, by which byte code is found to be that of the file.
            shutil.copy2(SOURCE / file, self.source / file)

    def run(self, tests: Sequence[str], limit_s: int = LIMIT_S, marks: str = "not long") -> Outcome:
        """Run tests, files or single ones, until one fails.

        Args:
            tests: for pytest, relative to the root of the project.
            limit_s: seconds of the processor.
            marks: which tests of files; single ones are run whatever they are.
        """
        told = self.folder / "told.json"
        told.unlink(missing_ok=True)
        began = time.monotonic()
        child = os.fork()
        if child == 0:
            words = [*([] if all("::" in test for test in tests) else ["-m", marks]), *tests]
            _in_child(self.source, self.folder, told, words, limit_s)
        status, ended = waited(child, limit_s * PATIENCE)
        seconds = round(time.monotonic() - began, 1)
        if not ended or (os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)):
            return Outcome(TIMEOUT, tests[0], seconds)
        if os.WIFSIGNALED(status) or not told.is_file():
            return Outcome(KILLED, tests[0], seconds)  # the process fell over
        report = json.loads(told.read_text("utf-8"))
        code = report["code"]
        if code == _PASSED:
            return Outcome(SURVIVED, "", seconds)
        if code in (_NO_TESTS, _USAGE):  # of usage: there is no such test any more
            return Outcome(NOTHING, "", seconds)
        return Outcome(KILLED, report["killer"] or tests[0], seconds)


def cache() -> Path:
    """Return the folder of the user in which compiled programs and the map of tests are kept."""
    return user_cache_path("qrsim") / "mutants"


@contextlib.contextmanager
def workshop() -> Iterator[Workshop]:
    """Make a workshop in a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="qrsim_mutants_") as folder:
        yield Workshop(Path(folder))


def _environment(source: Path) -> None:
    """Set what a run finds in its environment."""
    os.environ |= {
        "PYTHONPATH": f"{source}{os.pathsep}{ROOT}",
        # Its programs are found by sizes and times of sources.
        "QRSIM_COMPILATION_CACHE": "off",
        # Found by what is compiled, so a mutant finds its own or none.
        "JAX_COMPILATION_CACHE_DIR": str(cache() / "xla"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        # Most of what a test takes is compiling.
        "XLA_FLAGS": "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true",
        "OPENBLAS_NUM_THREADS": "1",
        "MPLBACKEND": "agg",
        # Loading what others bring for pytest takes as long as a test.
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
    }


def waited(child: int, patience_s: float) -> tuple[int, bool]:
    """Wait for a child; end it, with what it started, when patience is over."""
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status, True
        time.sleep(0.02)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    return os.waitpid(child, 0)[1], False


def _in_child(source: Path, folder: Path, told: Path, tests: Sequence[str], limit_s: int) -> None:
    """Run the tests and end the process."""
    code: int = _INTERNAL
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 30))
        resource.setrlimit(resource.RLIMIT_DATA, (LIMIT_BYTES, LIMIT_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        output = os.open(folder / "output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        os.chdir(ROOT)
        sys.path.insert(0, str(source))
        # What is changed is not kept.
        sys.dont_write_bytecode = True
        watch = _Watch()
        options = ["-x", "-q", "-p", "no:cacheprovider", "--durations=0", "--no-header"]
        code = int(pytest.main([*options, f"--basetemp={folder / 'basetemp'}", *tests], plugins=[watch]))
        qrsim = sys.modules.get("qrsim")
        assert qrsim is None or str(qrsim.__file__).startswith(str(source)), qrsim
        told.write_text(json.dumps({"code": code, "killer": watch.killer}), "utf-8")
        sys.stdout.flush()
    finally:
        os._exit(code)
