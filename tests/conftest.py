"""Strict mode for every test: silent rank or type promotion raises."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

# Before NumPy is imported. Matrices of tests are small, and two threads of BLAS take a hundred times the CPU of one.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jax
import pytest
from jax._src import compiler
from jax._src.interpreters import mlir

from qrsim.engine.settings import quick_to_compile

# Tests fly for seconds at most, which is too short to compile better code; the tiers have tests of their own.
os.environ.setdefault("QRSIM_TIER", "quick")
CACHE = os.environ.get("QRSIM_COMPILATION_CACHE")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")


def pytest_configure(config: pytest.Config) -> None:
    """Count the programs that tests compile."""
    from tests import one_by_one
    from tests.programs_made import ProgramsMade

    from qrsim.engine import by_llvm, by_xla

    made = ProgramsMade()
    made.watch(by_llvm, "build")
    made.watch(by_xla, "make", made.key_of_xla)
    config.pluginmanager.register(made, "programs_made")
    one_by_one.install()
    # Tracing makes many objects. By Python's defaults, a sixth of the time went to looking through those that stay.
    gc.set_threshold(100_000, 50, 100)


def pytest_collection_finish() -> None:
    """Let the collector leave out what was imported: it stays."""
    gc.freeze()


def pytest_sessionfinish() -> None:
    """Collect what is left while there is time for it, and let pytest's own last collection find nothing more.

    It follows the last word of a worker, and xdist sends Ctrl-C to a worker that has not ended five seconds after that.
    """
    gc.collect()
    gc.freeze()


DATA_INSTALL_LINE = "run 'qrsim data fetch' and set QRSIM_DATA_DIR to the folder it prints"

# Compiled programs stay in memory as long as JAX keeps them, which over a whole suite are several gigabytes.
GROWTH_LIMIT_BYTES = 3 * 2**29
_resident = {"last": 0}


@pytest.fixture(autouse=True, scope="module")
def _bounded_memory() -> Iterator[None]:
    """Let go of compiled programs between two files where the process has grown much since it last did so."""
    yield
    if resident_bytes() > _resident["last"] + GROWTH_LIMIT_BYTES:
        jax.clear_caches()
        gc.collect()
        # What is not given back to the system is used again.
        _resident["last"] = resident_bytes()


@pytest.fixture(autouse=True, scope="module")
def _same_cache() -> None:
    """Switch the cache of programs on again after a benchmark was flown, which switches it off."""
    os.environ.pop("QRSIM_COMPILATION_CACHE", None)
    if CACHE is not None:
        os.environ["QRSIM_COMPILATION_CACHE"] = CACHE


def resident_bytes() -> int:
    """Return the memory that the process holds, zero where the system does not say."""
    status = Path("/proc/self/statm")
    return int(status.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if status.is_file() else 0


# Rooms whose tests compile many programs that run for a moment.
QUICKLY_COMPILED = (
    "apps/test_cli_openloop.py",
    "apps/test_cli_validate.py",
    "control",
    "core",
    "envs",
    "interface",
    "laws",
    "models",
    "scenarios",
    "simulation",
    "studies/flight_logs",
    "studies/identify",
    "studies/slam",
    "studies/validate",
    "tasks",
    "world",
)
# Counts what is compiled, as users would see it.
AS_FOR_USERS = ("simulation/test_rollout.py",)
options_of_xla = compiler.get_compile_options


def quick_options(*given: Any, env_options_overrides: dict[str, Any] | None = None, **named: Any) -> Any:
    """Return XLA's options for a program: in rooms that are quickly compiled with the older code generator."""
    quick = quick_to_compile() if jax.config.values["jax_disable_most_optimizations"] else {}
    return options_of_xla(*given, env_options_overrides=quick | (env_options_overrides or {}), **named)


# JAX has no setting for it. It takes half the time.
compiler.get_compile_options = quick_options
# One context for all programs: to make one, with all its dialects, takes longer than to lower a small program.
mlir.make_ir_context = lru_cache(maxsize=1)(mlir.make_ir_context)


@pytest.fixture(autouse=True, scope="module")
def _quick_xla(request: pytest.FixtureRequest) -> Iterator[None]:
    """Have XLA compile without the passes that take longer than what they save in a test."""
    tests = Path(__file__).parent
    quick = any(request.path.is_relative_to(tests / room) for room in QUICKLY_COMPILED)
    quick &= request.path.relative_to(tests).as_posix() not in AS_FOR_USERS
    if quick:
        # Asks XLA, by a program, for the options that it knows.
        quick_to_compile()
    jax.config.update("jax_disable_most_optimizations", quick)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


@pytest.fixture
def heeded() -> Iterator[None]:
    """Heed Ctrl-C, which a child of a background process inherits as ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def as_for_users() -> Iterator[None]:
    """Have XLA compile as it does for users."""
    before = jax.config.values["jax_disable_most_optimizations"]
    jax.config.update("jax_disable_most_optimizations", False)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", before)


@pytest.fixture
def optimised() -> Iterator[None]:
    """Have XLA compile as it does for users, in a test that compares its programs with others."""
    with as_for_users():
        yield


@pytest.fixture(scope="session")
def optimising() -> Callable[[], contextlib.AbstractContextManager[None]]:
    """Return the same as a context, for a fixture with a loop that runs for longer than it takes to optimise."""
    return as_for_users


@pytest.fixture
def double_precision() -> Iterator[None]:
    """Compute in double precision: ``pytestmark = pytest.mark.usefixtures("double_precision")``."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of recordings; skips where it is absent."""
    folder = Path(os.environ.get("QRSIM_DATA_DIR", ""))
    if not os.environ.get("QRSIM_DATA_DIR") or not (folder / "rotation_rig.csv").is_file():
        pytest.skip(f"no recordings: QRSIM_DATA_DIR is not set to a folder that holds them; {DATA_INSTALL_LINE}")
    return folder


@pytest.fixture(scope="session")
def golden(recordings: Path) -> Path:
    """The folder of golden trajectories, beside the recordings; skips where it is absent."""
    folder = recordings.parent / "golden"
    if not (folder / "varied.csv").is_file():
        pytest.skip(f"no golden trajectories: expected {folder}; {DATA_INSTALL_LINE}")
    return folder


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., None]:
    """Return a function that runs a command and checks its exit code, its one error, and every given part of it."""

    def check(words: list[str], *parts: str, code: int = 2) -> None:
        from qrsim import cli

        assert cli.main(words) == code
        printed = capsys.readouterr()
        assert printed.err.count("error: ") == 1
        assert "Traceback" not in printed.err
        assert printed.out == ""
        for part in parts:
            assert part in printed.err

    return check
