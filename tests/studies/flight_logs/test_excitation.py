"""How much a log moves is measured right, and what it cannot show is said with the numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.studies.flight_logs.log_writing import DT, Floats, flown

from qrsim.core.tree import replace
from qrsim.studies.flight_logs import FlightLog
from qrsim.studies.flight_logs.excitation import (
    Excitation,
    described,
    follow,
    measure,
    noise_of,
    standing_still,
    why_unexcited,
    without_frozen,
    without_ground,
)

ANGLES, RATES = ("roll", "pitch", "yaw"), ("roll_rate", "pitch_rate", "yaw_rate")
VELOCITY = ("velocity_north", "velocity_east", "velocity_down")
MEASURED = (*ANGLES, *RATES, *VELOCITY)
# Standard deviation of noise that is believed at least, as documented.
LEAST_NOISE = dict.fromkeys(ANGLES, 2e-3) | dict.fromkeys(RATES, 0.01) | dict.fromkeys(VELOCITY, 0.05)


def as_log(signals: dict[str, Floats], **rates: float) -> FlightLog:
    kept = {name: values for name, values in signals.items() if name != "time"}
    return FlightLog("log", Path("log.csv"), "simulated", DT, signals["time"], kept, rates=rates)


@pytest.fixture(scope="module")
def log() -> FlightLog:
    return as_log(flown(20.0, seed=2))


def changed(log: FlightLog, **signals: Any) -> FlightLog:
    return replace(log, signals=log.signals | signals)


def of(log: FlightLog) -> Excitation:
    return measure(log, np.ones(len(log.time), bool))


def on_the_ground(log: FlightLog, rows: slice = slice(None)) -> FlightLog:
    rng = np.random.default_rng(3)
    signals = {name: values.copy() for name, values in log.signals.items()}
    for name in MEASURED:
        signals[name][rows] = 0.3 * LEAST_NOISE[name] * rng.standard_normal(len(log.time))[rows]
    return replace(log, signals=signals)


def test_noise_on_a_smooth_signal() -> None:
    """White noise of 0.02 on a slow sine of 1, over 5 000 rows, within 4 %; a gap does not count."""
    rng = np.random.default_rng(1)
    values = np.sin(0.02 * np.arange(5000)) + 0.02 * rng.standard_normal(5000)
    assert noise_of(values) == pytest.approx(0.02, rel=0.04)
    values[1000:1400] = np.nan
    assert noise_of(values) == pytest.approx(0.02, rel=0.04)


def test_a_flight_shows_what_it_was_asked_for(log: FlightLog) -> None:
    found = of(log)
    assert found.shown == ("roll", "pitch", "yaw", "drag", "heave")
    assert found.lacking == {"thrust": "no thrust in the log"}
    assert found.silent == ()
    assert found.still == 0.0
    assert found.follows["roll"] > 0.9


@pytest.mark.parametrize("name", MEASURED)
def test_a_signal_moves_from_three_times_the_least_noise_on(name: str, log: FlightLog) -> None:
    slow = np.sin(0.1 * np.arange(len(log.time)))
    slow = slow / np.std(slow)
    for ratio in (2.7, 3.3):
        movement = of(changed(log, **{name: ratio * LEAST_NOISE[name] * slow})).movements[name]
        assert movement.ratio == pytest.approx(ratio, rel=1e-6)
        assert movement.moves == (ratio > 3.0)


def test_what_was_not_asked_to_move(log: FlightLog) -> None:
    found = of(changed(log, yaw_rate_command=np.zeros(len(log.time)), throttle=np.full(len(log.time), 0.6)))
    assert found.shown == ("roll", "pitch", "drag")
    assert found.lacking["yaw"] == "yaw_rate_command is constant: not asked to move, though it does"
    assert found.lacking["heave"] == "throttle is constant: not asked to move"
    assert found.silent == ("yaw_rate", "yaw")


def test_a_vehicle_that_does_not_answer(log: FlightLog) -> None:
    found = of(on_the_ground(log))
    assert found.shown == ()
    assert found.still == 1.0
    assert "does not answer, although pitch_command moves by 0.1" in found.lacking["pitch"]
    assert "times its noise of 0.05): does not answer, although throttle moves by 0.0" in found.lacking["heave"]
    assert {"roll", "roll_rate", "yaw", "velocity_down"} <= set(found.silent)
    message, details = described([log], [found])
    assert message.startswith("log.csv: refused, and nothing is written: on the ground, or not flown")
    assert "\n" not in message
    assert any(line.startswith("  roll_rate moves by 0.00") for line in details)


def test_a_log_that_is_carried_by_hand(log: FlightLog) -> None:
    still = np.zeros(len(log.time))
    asked = ("roll_command", "pitch_command", "yaw_rate_command", "throttle")
    found = of(changed(log, **dict.fromkeys(asked, still)))
    assert found.shown == ()
    assert why_unexcited(found).startswith("not commanded: roll, pitch, roll_rate, pitch_rate, yaw_rate move")


@pytest.mark.parametrize(("share", "follows"), [(0.40, False), (0.60, True)])
def test_what_moves_is_to_follow_its_command(share: float, follows: bool, log: FlightLog) -> None:
    """A roll of which ``share`` is correlated with the command, the rest is not: 0.5 is needed."""
    rows = len(log.time)
    own = np.sin(0.9 * DT * np.arange(rows)) * np.sqrt(2.0)
    asked = log.signals["roll_command"]
    asked = np.convolve((asked - asked.mean()) / asked.std(), np.ones(25) / 25, "same")
    asked = (asked - asked.mean()) / asked.std()
    own = own - asked * (own @ asked) / rows
    own = own / own.std()
    roll = 0.1 * (share * asked + np.sqrt(1.0 - share**2) * own)
    found = of(changed(log, roll=roll, roll_command=0.2 * asked))
    assert found.follows["roll"] == pytest.approx(share, abs=0.08)
    assert ("roll" in found.shown) == follows
    assert ("roll" in found.silent) != follows


def test_a_wrong_sign_does_not_follow(log: FlightLog) -> None:
    turned = changed(log, roll_command=-log.signals["roll_command"])
    assert of(turned).shown == ("pitch", "yaw", "drag", "heave")
    found = of(changed(turned, pitch_command=-log.signals["pitch_command"]))
    assert found.shown == ("yaw",)
    assert found.lacking["heave"] == "neither roll nor pitch follows a command, so that no velocity is predicted"
    assert set(VELOCITY) <= set(found.silent)


@pytest.mark.parametrize(("rate", "shown"), [(4.5, False), (5.5, True)])
def test_slow_logs_show_no_attitude(rate: float, shown: bool, log: FlightLog) -> None:
    found = of(replace(log, rates={"roll_rate": rate, "velocity_down": 0.4 * rate}))
    assert ("roll" in found.shown) == shown
    assert ("heave" in found.shown) == shown
    if not shown:
        assert found.lacking["roll"] == "roll_rate was logged at 4.5 Hz; at least 5 Hz are needed"
        assert found.lacking["heave"] == "velocity_down was logged at 1.8 Hz; at least 2 Hz are needed"
        slow = of(replace(log, rates=dict.fromkeys(log.signals, 1.0)))
        assert slow.shown == ()
        assert why_unexcited(slow) == "logged too slowly to show how a vehicle answers"


@pytest.mark.parametrize(("acceleration", "shown"), [(0.85, False), (1.15, True)])
def test_a_throttle_that_moves_lifts(acceleration: float, shown: bool, log: FlightLog) -> None:
    """A fifth of 9.81 m/s^2 for a unit of throttle is the least."""
    rows = np.arange(len(log.time))
    phase = 2.0 * np.pi * rows * DT / 8.0
    # Means over half a second are smaller by the same factor on both sides.
    throttle = 0.5 + 0.4 * np.sin(phase)
    down = acceleration * 0.2 * 9.81 * 0.4 * 8.0 / (2.0 * np.pi) * np.cos(phase)
    found = of(changed(log, throttle=throttle, velocity_down=down))
    assert ("heave" in found.shown) == shown
    if not shown:
        assert "not in free flight, or no multirotor" in found.lacking["heave"]


def test_time_on_the_ground_is_left_out(log: FlightLog) -> None:
    throttle = log.signals["throttle"].copy()
    throttle[:300], throttle[600:700], throttle[950:] = 0.1, 0.1, 0.1
    landed = on_the_ground(on_the_ground(on_the_ground(log, slice(0, 300)), slice(600, 700)), slice(950, None))
    landed = changed(landed, throttle=throttle)
    assert np.flatnonzero(standing_still(landed)).tolist() == [*range(300), *range(600, 700), *range(950, 1000)]
    left = without_ground(landed)
    assert len(left.time) == 650
    assert left.time[0] == 0.0
    assert np.flatnonzero(np.isnan(left.signals["roll"])).tolist() == list(range(300, 400))
    assert "9.0 s on the ground are left out; times count from 6.00 s" in left.notes
    # At the throttle of flight a quiet hover is none.
    assert not standing_still(on_the_ground(log, slice(0, 400))).any()
    assert without_ground(log) is log


def test_a_sensor_that_hangs_is_left_out(log: FlightLog) -> None:
    roll, command = log.signals["roll"].copy(), log.signals["roll_command"].copy()
    roll[100:145] = roll[100]
    roll[300:360] = roll[300]
    command[:] = 0.1
    left = without_frozen(changed(log, roll=roll, roll_command=command))
    assert np.flatnonzero(np.isnan(left.signals["roll"])).tolist() == list(range(300, 360))
    assert "roll: the same to the last digit for 1.20 s, first at 6.00 s; left out" in left.notes
    assert without_frozen(log) is log


@pytest.mark.parametrize(("delay_s", "follows"), [(0.1, True), (0.6, True), (0.78, False)])
def test_an_answer_may_be_late_but_not_by_more_than_documented(delay_s: float, follows: bool) -> None:
    """White commands, so that no other delay correlates: up to 0.7 s, and five rows over which both are averaged."""
    rng, lag = np.random.default_rng(5), round(delay_s / DT)
    command = rng.standard_normal(4000)
    assert (follow(command[lag:], command[: len(command) - lag], DT) > 0.5) == follows


@pytest.mark.parametrize(("share", "words"), [(0.96, "on the ground"), (0.94, "not in flight")])
def test_a_log_is_of_the_ground_when_hardly_anything_moves(share: float, words: str, log: FlightLog) -> None:
    assert why_unexcited(replace(of(log), still=share)).startswith(words)
