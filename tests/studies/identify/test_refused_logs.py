"""Logs that show nothing end in one line, exit code 1 and no file, whatever is wrong with them and in any format."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.studies.flight_logs.log_writing import Floats, flown, write_csv, write_ulog

from qrsim import cli

Signals = dict[str, Floats]
COMMANDS = ("roll_command", "pitch_command", "yaw_rate_command", "throttle", "battery")


@pytest.fixture(scope="module")
def signals() -> Signals:
    """A flight of 10 s that shows all constants."""
    return flown(10.0, 3)


def hover(s: Signals) -> Signals:
    """A hover in calm air: commands that are constant, motion that is noise."""
    rng = np.random.default_rng(4)
    still = {name: 1e-3 * rng.standard_normal(len(v)) for name, v in s.items() if name not in (*COMMANDS, "time")}
    asked = {"roll_command": 0.0, "pitch_command": 0.0, "yaw_rate_command": 0.0, "throttle": 0.59, "battery": 12.0}
    return {"time": s["time"], **still, **{name: np.full(len(s["time"]), value) for name, value in asked.items()}}


def of_1_s(s: Signals) -> Signals:
    return {name: values[:50] for name, values in s.items()}


def jumped(seconds: float, row: int = 250) -> Callable[[Signals], Signals]:
    return lambda s: s | {"time": s["time"] + np.where(np.arange(len(s["time"])) >= row, seconds, 0.0)}


def constant(*names: str) -> Callable[[Signals], Signals]:
    return lambda s: (
        {name: values for name, values in s.items() if name in ("time", *names)}
        | {name: np.zeros(len(s["time"])) for name in names if name != "time"}
    )


def lost(name: str) -> Callable[[Signals], Signals]:
    return lambda s: s | {name: np.full(len(s["time"]), np.nan)}


ROTATION = ("roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate", *COMMANDS[:3])
# By kind: what is done to the flight, and what the line must say.
LOGS: dict[str, tuple[Callable[[Signals], Signals], str]] = {
    "hover": (hover, "refused, and nothing is written: on the ground, or not flown"),
    "constant": (constant(*ROTATION), "refused, and nothing is written: on the ground, or not flown"),
    "1 s": (of_1_s, "too short: its signals have 0.98 s in common, at least 4 s are needed"),
    "1e9 s later": (jumped(1e9), "the largest step of the clock: roll from 4.98 s to 1e+09 s, 1e+09 s"),
    "1e300 s later": (jumped(1e300), "allowed: up to 36000 s; the largest step of the clock: roll from 4.98 s"),
    "last row later": (jumped(1e9, 499), "the largest step of the clock: roll from 9.96 s to 1e+09 s"),
    "no roll": (lost("roll"), "roll: 0 usable samples of 500"),
    "no time": (lost("time"), "0 usable samples of 500"),
    "no command": (lost("pitch_command"), "pitch_command: 0 usable samples of 500"),
}


def refused_in_one_line(words: list[str], said: str, capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    """Run a command that must refuse its log: one line on stderr, exit code 1, and nothing beside what was there."""
    before = sorted(folder.iterdir())
    assert cli.main([*words, "--quiet", "-o", str(folder / "v.yaml")]) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("error: ")
    assert printed.err.count("\n") == 1
    assert said in printed.err
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("kind", LOGS)
@pytest.mark.parametrize("app", ["identify", "discover"])
def test_table(app: str, kind: str, signals: Signals, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    change, said = LOGS[kind]
    path = write_csv(tmp_path / "log.csv", change(signals))
    refused_in_one_line([app, str(path)], said, capsys, tmp_path)


@pytest.mark.parametrize("kind", ["hover", "1 s", "1e9 s later"])
def test_table_of_ulogs(kind: str, signals: Signals, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    said = {"hover": "on the ground, or not flown", "1 s": "too short", "1e9 s later": "the largest step of the clock"}
    path = write_ulog(tmp_path / "log.ulg", LOGS[kind][0](signals))
    refused_in_one_line(["identify", str(path)], said[kind], capsys, tmp_path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the file is empty"),
        ("\n\n", "the file is empty"),
        ("time [s],roll [rad]\n", "roll: 0 usable samples of 0"),
        ("time [s],roll [rad]\n0,0\n", "roll: 1 usable samples of 1"),
        ("time [s],roll\n0,0\n", "'roll' has no unit"),
        ("time [s],roll [rad]\n0,a\n", "line 2: column 'roll [rad]': 'a' is not a number"),
        ("\x00\x01\x02", "neither ULog nor DataFlash nor text"),
        ("ULog", "a ULog that cannot be read"),
    ],
)
def test_files_without_rows(text: str, said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    refused_in_one_line(["identify", str(path)], said, capsys, tmp_path)


def test_a_jump_of_the_clock_takes_no_memory(
    signals: Signals, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = write_csv(tmp_path / "log.csv", jumped(1e9)(signals))
    tracemalloc.start()
    refused_in_one_line(["identify", str(path)], "the largest step of the clock", capsys, tmp_path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # A grid of 20 ms over that time would have 5e10 rows of 8 bytes.
    assert most < 50e6


def test_what_was_measured_is_printed(signals: Signals, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", hover(signals))
    assert cli.main(["identify", str(path), "-o", str(tmp_path / "v.yaml")]) == 1
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert "  throttle is constant\n" in printed.out
    assert "  kr0, kr1: yaw_rate_command is constant: not asked to move" in printed.out
    assert not (tmp_path / "v.yaml").exists()
