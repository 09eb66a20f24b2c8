"""Processes in PX4's place: how they are ended, and what is said of their end."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from qrsim.links.autopilot import px4_process


def flight_of(folder: Path, program: str, count: int) -> tuple[Any, Any]:
    """Return what stands for a build and for a flight of ``count`` vehicles."""
    px4 = folder / "px4"
    px4.write_text(f"#!{sys.executable}\n{program}")
    px4.chmod(0o755)
    links = [SimpleNamespace(name=f"quad_{i}", instance=i, ended=str) for i in range(count)]
    flight = SimpleNamespace(links=links, parameters=lambda: [{}] * count, closing=ExitStack())
    return SimpleNamespace(program=px4, folder=folder), flight


def until(true: Any) -> None:
    end = time.monotonic() + 10.0
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.long
def test_all_are_asked_to_end_before_the_first_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4_process, "END_S", 0.5)
    stubborn = "import signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\nprint('up', flush=True)\n"
    build, flight = flight_of(tmp_path, f"{stubborn}time.sleep(60)", 8)
    px4_process.started(build, flight, {}, tmp_path / "logs")
    until(lambda: all((tmp_path / "logs" / link.name / "px4.log").read_text() for link in flight.links))
    begin = time.monotonic()
    flight.closing.close()
    # One wait for all; one after the other would take 4 s.
    assert 0.4 < time.monotonic() - begin < 3.5
    assert all("was killed by SIGKILL" in link.ended() for link in flight.links)


def test_what_is_said_of_the_end_is_short(tmp_path: Path) -> None:
    build, flight = flight_of(tmp_path, "print('first')\nprint('x' * 10**6)\nprint('last')\nraise SystemExit(3)", 1)
    px4_process.started(build, flight, {}, tmp_path / "logs")
    (link,) = flight.links
    until(link.ended)
    said = link.ended()
    assert said.startswith("PX4 has ended with code 3; its last lines: xxx")
    assert said.endswith("xxx | last")
    assert len(said) < 300
    flight.closing.close()
