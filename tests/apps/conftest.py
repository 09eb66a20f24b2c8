"""Fixtures of the command-line tests: one short flight of the default scenario, which everything looks at."""

from __future__ import annotations

import contextlib
import io
import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from tests.small_worlds import bare_pair

from qrsim import cli
from qrsim.runs.recorder import fly as record
from qrsim.view.clock import Clock
from qrsim.view.live import LiveView

SEED, DURATION = 3, 10.0


@dataclass(frozen=True)
class Flight:
    """A run folder, and what was said about it."""

    folder: Path
    code: int
    printed: str
    complaints: str

    @property
    def json(self) -> dict[str, Any]:
        """The output of --json."""
        return json.loads(self.printed)


@pytest.fixture(scope="session")
def fly(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Flight]:
    """Return a function that flies in this process into a new folder, and captures what is printed."""

    def run(*words: str) -> Flight:
        folder = tmp_path_factory.mktemp("runs") / "run"
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = cli.main(["run", *words, "--out", str(folder)])
        return Flight(folder, code, out.getvalue(), err.getvalue())

    return run


@pytest.fixture(scope="session")
def flown(fly: Callable[..., Flight]) -> Flight:
    """The default scenario, 10 s, with --json."""
    return fly("--seed", str(SEED), "--duration", f"{DURATION:g}", "--json")


@pytest.fixture(scope="session")
def flown_again(fly: Callable[..., Flight], flown: Flight) -> Flight:
    """The resolved scenario of ``flown`` with the same seed, as a table."""
    return fly(str(flown.folder / "scenario.yaml"), "--seed", str(SEED), "--no-figure")


@contextlib.contextmanager
def flying(folder: Path, duration: float, clock: Clock) -> Iterator[tuple[LiveView, threading.Thread]]:
    """Fly with a page in a thread; its address is known at once."""
    view = LiveView(0, clock)
    flight = threading.Thread(
        target=lambda: record(bare_pair(duration=duration), folder, seed=1, precision="float32", view=view), daemon=True
    )
    with contextlib.closing(view):
        flight.start()
        yield view, flight
        clock.close()
        flight.join(60.0)
