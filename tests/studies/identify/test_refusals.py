"""Logs that cannot tell are refused with the reason; what broken ones identify predicts better than the start."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.studies.flight_logs.log_writing import Floats, flown, write_csv

from qrsim import cli
from qrsim.core.tree import replace
from qrsim.errors import LogError, QrsimError
from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.studies.flight_logs import read_log
from qrsim.studies.identify.constants import CONSTANTS, PITCH, bounds_of
from qrsim.studies.identify.fit import Question
from qrsim.studies.identify.identification import identify

START = {name: float(getattr(Quadrotor(), name)) for name in CONSTANTS if name not in PITCH}
ANGLES, RATES = ("roll", "pitch", "yaw"), ("roll_rate", "pitch_rate", "yaw_rate")
VELOCITY = ("velocity_north", "velocity_east", "velocity_down")
TURNED = ("roll_command", "pitch_command", "yaw_rate_command")
ROTATION = ("time", *ANGLES, *RATES, *TURNED)
Signals = dict[str, Floats]


@pytest.fixture(scope="module")
def signals() -> Signals:
    """A flight of 16 s of a vehicle that differs from the published one."""
    return flown(16.0, 5, replace(Quadrotor(), kpq1=150.0, kpq2=-20.0, kr1=-6.5, kuv=-0.7, cth2=2.6e-6))


def grounded(signals: Signals) -> Signals:
    rng = np.random.default_rng(0)
    noise = dict.fromkeys(ANGLES, 3e-4) | dict.fromkeys(RATES, 3e-3) | dict.fromkeys(VELOCITY, 0.01)
    return signals | {name: size * rng.standard_normal(len(signals["time"])) for name, size in noise.items()}


def test_a_log_on_the_ground_is_refused(signals: Signals, refused: Callable[..., None], tmp_path: Path) -> None:
    path = write_csv(tmp_path / "bench.csv", grounded(signals))
    said = "bench.csv: refused, and nothing is written: on the ground, or not flown"
    refused(["identify", str(path), "--quiet", "-o", str(tmp_path / "v.yaml")], said, code=1)
    refused(["discover", str(path), "--quiet", "-o", str(tmp_path / "v.yaml")], said, code=1)
    with pytest.raises(LogError) as caught:
        identify([read_log(path)], Question((), START))
    details = "\n".join(caught.value.details)
    for part in (
        "roll moves by 0.000",
        "velocity_down moves by 0.0",
        "kpq0, kpq1, kpq2: ",
        "does not answer, although roll_command moves by 0.1",
    ):
        assert part in details
    assert not (tmp_path / "v.yaml").exists()
    assert not (tmp_path / "v_report").exists()


@pytest.mark.long
@pytest.mark.parametrize("app", ["identify", "discover"])
@pytest.mark.parametrize("name", ["sample_log_small.ulg", "sample_logging_tagged_and_default_params.ulg"])
def test_published_logs_of_autopilots_on_the_ground(
    app: str, name: str, recordings: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = recordings / "px4" / name
    if not path.is_file():
        pytest.skip(f"no {path}")
    assert cli.main([app, str(path), "-o", str(tmp_path / "v.yaml")]) == 1
    printed = capsys.readouterr()
    said = "on the ground, or not flown: nothing that a vehicle turns or lifts itself by moves more than its noise"
    assert printed.err == f"error: {path}: refused, and nothing is written: {said}\n"
    assert "  roll_rate moves by 0.00" in printed.out
    assert ("  yaw: " if app == "discover" else "  kr0, kr1: ") in printed.out
    assert list(tmp_path.iterdir()) == []


def judge(path: Path) -> dict[str, str]:
    """Identify a log, check what must hold whatever it is, and return the status of each constant; {} if refused."""
    log = read_log(path)
    try:
        found = identify([log], Question((), START), 2.0)
    except QrsimError:
        return {}
    told = found.to_json()
    json.dumps(told["verdicts"], allow_nan=False)
    for name, verdict in told["verdicts"].items():
        low, high = bounds_of(name, START[name])
        assert math.isfinite(verdict["value"]), name
        if verdict["status"] == "held":
            assert verdict["value"] == START[name], name
            assert verdict["why"], name
        else:
            assert low + 1e-4 * (high - low) < verdict["value"] < high - 1e-4 * (high - low), name
    scored = told["logs"][0]["held_out"]
    named = [name for name, each in told["logs"][0]["channels"].items() if each.get("identified")]
    assert named or "identified" not in {each["status"] for each in told["verdicts"].values()}
    for name in named:
        assert scored["identified"][name] < scored["start"][name], name
    return {name: each["status"] for name, each in told["verdicts"].items()}


@pytest.mark.long
def test_eight_seconds_are_enough(signals: Signals, tmp_path: Path) -> None:
    """Their fitted part is shorter than one window of the usual length."""
    kept = {name: signals[name][:400] for name in ROTATION}
    found = judge(write_csv(tmp_path / "short.csv", kept))
    assert [name for name, status in found.items() if status == "identified"] == ["kpq0", "kpq1", "kpq2", "kr0", "kr1"]


def frozen(*names: str) -> Callable[[Signals], Signals]:
    return lambda s: s | {name: np.full_like(s[name], s[name][0]) for name in names}


def each(names: tuple[str, ...], change: Callable[[Floats], Floats]) -> Callable[[Signals], Signals]:
    return lambda s: s | {name: change(s[name]) for name in names}


def sampled(every: int) -> Callable[[Signals], Signals]:
    return lambda s: {name: values[::every] for name, values in s.items()}


def walk(values: Floats) -> Floats:
    return np.cumsum(0.02 * np.random.default_rng(1).standard_normal(len(values)))


def noisy(size: float) -> Callable[[Floats], Floats]:
    return lambda values: values + size * np.random.default_rng(len(values)).standard_normal(len(values))


def holed(values: Floats) -> Floats:
    return np.where((np.arange(len(values)) // 60) % 4 == 3, np.nan, values)


BROKEN: dict[str, Callable[[Signals], Signals]] = {
    "cut to 5 s": lambda s: {name: values[:250] for name, values in s.items()},
    **{f"{name} frozen": frozen(name) for name in ("roll", "pitch_rate", "yaw", "velocity_down", "velocity_north")},
    **{f"{name} constant": frozen(name) for name in (*TURNED, "throttle", "battery")},
    "no command moves": frozen(*TURNED, "throttle"),
    "roll command biased and scaled": each(("roll_command",), lambda v: 0.8 * v + 0.1),
    "angles saturated": each(("roll", "pitch"), lambda v: np.clip(v, -0.05, 0.05)),
    "commands saturated": each(("roll_command", "pitch_command"), lambda v: np.clip(v, -0.05, 0.05)),
    "command of the wrong sign": each(("roll_command", "pitch_command"), lambda v: -v),
    "roll and pitch swapped": lambda s: s | {"roll_command": s["pitch_command"], "pitch_command": s["roll_command"]},
    "throttle a hundredth": each(("throttle",), lambda v: 0.01 * v),
    "throttle upside down": each(("throttle",), lambda v: 1.0 - v),
    "throttle a quarter": each(("throttle",), lambda v: 0.25 * v),
    "on the ground": grounded,
    "first half on the ground": lambda s: {
        name: np.concatenate([(grounded(s) | {n: 0.0 * s[n] for n in (*TURNED, "throttle")})[name][:400], values[400:]])
        if name != "time"
        else values
        for name, values in s.items()
    },
    "noisy": each((*ANGLES, *RATES, *VELOCITY), noisy(0.05)),
    "noise": each((*ANGLES, *RATES, *VELOCITY), noisy(0.3)),
    **{f"at {50 // every} Hz": sampled(every) for every in (5, 10, 25)},
    "holed": each((*ANGLES, "throttle"), holed),
    "yaw wrapped": each(("yaw",), lambda v: (v + 3.1 + np.pi) % (2.0 * np.pi) - np.pi),
    "offsets": each(("roll", "pitch", "velocity_down"), lambda v: v + 0.3),
    "one axis copied": lambda s: (
        s
        | {name.replace("roll", "pitch"): s[name] for name in ("roll", "roll_rate")}
        | {"pitch_command": s["roll_command"]}
    ),
    "velocities of something else": each(VELOCITY, walk),
    "commands of something else": each((*TURNED, "throttle"), lambda v: np.roll(v, 333)),
    "commands late by 1.2 s": each((*TURNED, "throttle"), lambda v: np.roll(v, -60)),
    "upside down": each(("roll",), lambda v: v + 3.0),
    "nose up": each(("pitch",), lambda v: v + 1.3),
    "quiet where it is fitted": each(
        (*ANGLES, *RATES, *TURNED), lambda v: np.where(np.arange(len(v)) < 480, 1e-3 * v, v)
    ),
    "quiet where it is scored": each(
        (*ANGLES, *RATES, *VELOCITY, *TURNED), lambda v: np.where(np.arange(len(v)) < 480, v, 1e-3 * v)
    ),
    "quantised": each((*ANGLES, *RATES, *VELOCITY), lambda v: np.round(v, 2)),
}


# One of each kind; the others differ in which signal is broken, or by how much.
LONG = (
    "cut to 5 s", "roll frozen", "no command moves", "command of the wrong sign", "on the ground", "noise", "at 2 Hz",
    "holed", "velocities of something else", "quiet where it is fitted",
)  # fmt: skip


@pytest.mark.nightly
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in LONG else pytest.mark.nightly) for name in BROKEN]
)
def test_broken_logs(name: str, signals: Signals, tmp_path: Path) -> None:
    judge(write_csv(tmp_path / "broken.csv", BROKEN[name](signals)))
