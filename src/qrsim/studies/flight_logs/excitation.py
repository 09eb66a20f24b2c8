"""Excitation of a log: each signal against its noise, correlation with commands, and times at rest.

A law can be fitted only to motion that a command caused and that is larger than the noise. Noise is what fourth
differences leave, which no motion of a vehicle does within five rows; because autopilots log what filters have
smoothed, it counts for no less than a floor, which is what their estimates drift by on the ground.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from qrsim.studies.flight_logs.signals import SIGNALS, FlightLog, Floats

Rows = npt.NDArray[np.bool_]  # whether a row counts

# What the noise of each signal counts for at least.
FLOORS: dict[str, float] = {
    "roll": 2e-3,
    "pitch": 2e-3,
    "yaw": 2e-3,
    "roll_rate": 0.01,
    "pitch_rate": 0.01,
    "yaw_rate": 0.01,
    "velocity_north": 0.05,
    "velocity_east": 0.05,
    "velocity_down": 0.05,
    "thrust": 0.05,
    "roll_command": 2e-3,
    "pitch_command": 2e-3,
    "yaw_rate_command": 5e-3,
    "throttle": 3e-3,
    "battery": 0.02,
}
# Standard deviation over noise from which on a signal moves.
MOVES = 3.0
# Correlation of a measurement with its command, at the best delay, from which on it follows.
FOLLOWS = 0.5
LONGEST_DELAY_S = 0.7
# Correlations are of means over so many rows, because the noise of rates is large.
SMOOTHED_ROWS = 5
# A signal that is logged less often [Hz] shows nothing of a motion as fast as an attitude's, or a velocity's.
SLOWEST_ATTITUDE_HZ, SLOWEST_VELOCITY_HZ = 5.0, 2.0
# Change of velocity over this time [s] is what a throttle is compared with. Full throttle lifts whatever flies by more
# than 1 g, so that a unit of throttle is worth more than that; a vehicle in flight shows at least this share of it.
LIFT_S, LEAST_LIFT = 0.5, 0.2 * 9.81
# Share of the rows in which nothing moves from which on a log counts as one on the ground.
ON_THE_GROUND = 0.95
# A sensor that gives the same number for longer [s] hangs.
FROZEN_S = 1.0
# Rows are looked at by so much time when it is told what stands still.
STILL_S = 1.0


@dataclass(frozen=True)
class Movement:
    """Movement of a signal.

    Attributes:
        std: standard deviation, in the signal's unit.
        noise: of one row, at least its floor.
        rate_hz: how often it was logged; NaN where that is not known.
    """

    std: float
    noise: float
    rate_hz: float

    @property
    def ratio(self) -> float:
        """Standard deviation of the signal over its noise."""
        return self.std / self.noise

    @property
    def moves(self) -> bool:
        """Whether the signal moves by more than its noise."""
        return self.ratio >= MOVES

    @property
    def frozen(self) -> bool:
        """Whether all samples are equal, so that nothing was measured."""
        return self.std == 0.0


@dataclass(frozen=True)
class Aspect:
    """One kind of response of a vehicle.

    Attributes:
        command: which is to move.
        channels: which are to follow it; those of drag follow no single command.
    """

    command: str
    channels: tuple[str, ...]


ASPECTS: dict[str, Aspect] = {
    "roll": Aspect("roll_command", ("roll", "roll_rate")),
    "pitch": Aspect("pitch_command", ("pitch", "pitch_rate")),
    "yaw": Aspect("yaw_rate_command", ("yaw_rate",)),
    "drag": Aspect("", ("velocity_north", "velocity_east")),
    "heave": Aspect("throttle", ("velocity_down",)),
    "thrust": Aspect("throttle", ("thrust",)),
}


COMMANDED = tuple(dict.fromkeys(each.command for each in ASPECTS.values() if each.command))
# Yaw and velocity drift on the ground too.
TURNING = ("roll", "pitch", "roll_rate", "pitch_rate", "yaw_rate", "thrust")


@dataclass(frozen=True)
class Excitation:
    """Excitation of a part of a log.

    Attributes:
        movements: of each signal by name.
        follows: largest correlation of an aspect's measurement with its command at a delay up to LONGEST_DELAY_S.
        lacking: by aspect, why the log does not show it; aspects that it shows are not there.
        silent: channels that were not measured or too slowly, do not follow a command that moves or move without being
            asked, so that no fit can use them.
        still: share of the rows in which nothing moves.
    """

    movements: dict[str, Movement]
    follows: dict[str, float]
    lacking: dict[str, str]
    silent: tuple[str, ...]
    still: float

    @property
    def shown(self) -> tuple[str, ...]:
        """Names of the aspects of motion (such as "roll", "drag") that the log excites."""
        return tuple(name for name in ASPECTS if name not in self.lacking)


def measure(log: FlightLog, rows: Rows) -> Excitation:
    """Return how much the signals of a log move and follow their commands in ``rows``, a mask (T,)."""
    part = {name: np.where(rows, values, np.nan) for name, values in log.signals.items()}
    movements = {name: _movement(name, values, log.rates.get(name, math.nan)) for name, values in part.items()}
    follows = {
        name: follow(part[each.command], part[each.channels[-1 if name == "yaw" else 0]], log.dt)
        for name, each in ASPECTS.items()
        if name in ("roll", "pitch", "yaw") and {each.command, *each.channels} <= set(part)
    }
    lacking, silent = {}, [name for name, each in movements.items() if each.frozen and not SIGNALS[name].command]
    for name in ASPECTS:
        why, deaf = _missing_excitation(name, movements, follows, part, log.dt)
        if why:
            lacking[name] = why
        if deaf:
            silent += [channel for channel in ASPECTS[name].channels if channel in part]
            silent += ["yaw"] if name == "yaw" else []
    if {"roll", "pitch"} <= set(silent):
        # Velocity cannot be predicted without a tilt that is.
        unpredicted = [name for name in ("drag", "heave") if name not in lacking]
        lacking |= dict.fromkeys(
            unpredicted, "neither roll nor pitch follows a command, so that no velocity is predicted"
        )
        silent += [channel for name in ("drag", "heave") for channel in ASPECTS[name].channels if channel in part]
    still = standing_still(log) & rows
    return Excitation(
        movements, follows, lacking, tuple(dict.fromkeys(silent)), float(still.sum() / max(int(rows.sum()), 1))
    )


def _movement(name: str, values: Floats, rate_hz: float) -> Movement:
    """Return the movement of a signal (T,): standard deviation, noise and logging rate."""
    good = values[np.isfinite(values)]
    if len(good) < 2 or np.ptp(good) == 0.0:
        return Movement(0.0, FLOORS[name], rate_hz)
    return Movement(float(np.std(good)), max(noise_of(values), FLOORS[name]), rate_hz)


def noise_of(values: Floats) -> float:
    """Estimate the standard deviation of white noise on a smooth signal (T,), NaN in gaps, by fourth differences."""
    left = np.diff(values, n=4)
    left = left[np.isfinite(left)]
    # 70 is the sum of the squares of 1, 4, 6, 4, 1; 0.6745 is the median magnitude of a standard normal.
    return float(np.median(np.abs(left)) / 0.6745 / math.sqrt(70.0)) if len(left) else 0.0


def follow(command: Floats, measured: Floats, dt: float) -> float:
    """Return the largest correlation of a measurement (T,) with its command, over delays up to LONGEST_DELAY_S."""
    kernel = np.ones(SMOOTHED_ROWS) / SMOOTHED_ROWS
    # A gap spreads to the rows beside it, which then count for nothing.
    asked, found = np.convolve(command, kernel, "same"), np.convolve(measured, kernel, "same")
    best = 0.0
    for lag in range(round(LONGEST_DELAY_S / dt) + 1):
        best = max(best, correlation(asked[: len(asked) - lag], found[lag:]))
    return best


def correlation(first: Floats, second: Floats) -> float:
    """Return the correlation of two signals (T,) over rows without NaN; 0 if one is constant."""
    good = np.isfinite(first) & np.isfinite(second)
    if good.sum() < 3:
        return 0.0
    a, b = first[good] - first[good].mean(), second[good] - second[good].mean()
    scale = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / scale if scale > 0.0 else 0.0


def _missing_excitation(
    name: str, movements: Mapping[str, Movement], follows: Mapping[str, float], part: Mapping[str, Floats], dt: float
) -> tuple[str, bool]:
    """Return why a log does not excite an aspect of motion ("" if it does), and whether fits must ignore it."""
    aspect = ASPECTS[name]
    missing = [each for each in (aspect.command, *aspect.channels) if each and each not in movements]
    if missing:
        return f"no {' and no '.join(missing)} in the log", False
    slowest = SLOWEST_ATTITUDE_HZ if name in ("roll", "pitch", "yaw") else SLOWEST_VELOCITY_HZ
    for each in (aspect.command, *aspect.channels):
        if each and movements[each].rate_hz < slowest:
            return f"{each} was logged at {movements[each].rate_hz:.3g} Hz; at least {slowest:g} Hz are needed", True
    still = [each for each in aspect.channels if not movements[each].moves]
    if aspect.command and not movements[aspect.command].moves:
        why = f"{told(aspect.command, movements[aspect.command])}: not asked to move"
        return (f"{why}, though it does", True) if not still and name != "heave" else (why, False)
    if name == "drag":
        tilts = [each for each in ("roll", "pitch") if follows.get(each, 0.0) >= FOLLOWS and movements[each].moves]
        if len(still) == len(aspect.channels):
            return "; ".join(told(each, movements[each]) for each in still) + ": does not move", False
        return ("" if tilts else "neither roll nor pitch moves as commanded, so that no velocity is due to them"), False
    if still:
        return (
            "; ".join(told(each, movements[each]) for each in still)
            + f": does not answer, although {told(aspect.command, movements[aspect.command])}"
        ), True
    if name in follows and follows[name] < FOLLOWS:
        return (
            f"correlation of {aspect.channels[-1 if name == 'yaw' else 0]} with {aspect.command} is"
            f" {follows[name]:.2f}, at least {FOLLOWS:g} is needed: does not follow its command"
        ), True
    return _lift_objection(part, movements, dt) if name == "heave" else ("", False)


def _lift_objection(part: Mapping[str, Floats], movements: Mapping[str, Movement], dt: float) -> tuple[str, bool]:
    """Return (reason, True) if throttle and vertical velocity cannot be those of a flight, else ("", False)."""
    rows = max(1, round(LIFT_S / dt))
    down, throttle = part["velocity_down"], part["throttle"]
    lift = float(np.nanstd((down[rows:] - down[:-rows]) / (rows * dt)))
    mean = np.convolve(throttle, np.ones(rows) / rows, "valid")
    expected = LEAST_LIFT * float(np.nanstd(mean)) if np.isfinite(mean).any() else 0.0
    if lift >= expected:
        return "", False
    return (
        f"vertical acceleration varies by {lift:.3g} m/s^2 where {told('throttle', movements['throttle'])}, which"
        f" changes that of whatever flies by {expected:.3g} m/s^2 at least: not in free flight, or no multirotor"
    ), True


def told(name: str, movement: Movement) -> str:
    """Return as text how much a signal moves compared with its noise."""
    if movement.frozen:
        return f"{name} is constant"
    unit = "" if SIGNALS[name].unit == "1" else f" {SIGNALS[name].unit}"
    return f"{name} moves by {movement.std:.3g}{unit} ({movement.ratio:.2g} times its noise of {movement.noise:.2g})"


def described(logs: Sequence[FlightLog], excitations: Sequence[Excitation]) -> tuple[str, list[str]]:
    """Return the error message that refuses logs without excitation, and lines on each signal's movement."""
    natures: dict[str, list[str]] = {}
    details = []
    for log, each in zip(logs, excitations, strict=True):
        natures.setdefault(why_unexcited(each), []).append(str(log.source))
        details += [f"{log.source}, how much its signals move:"]
        details += [f"  {told(name, movement)}" for name, movement in each.movements.items()]
    refused = [f"{', '.join(names)}: refused, and nothing is written: {why}" for why, names in natures.items()]
    return "; ".join(refused), details


def why_unexcited(excitation: Excitation) -> str:
    """Return as text why a log lacks excitation: on the ground, logged too slowly, not commanded, not following."""
    moving = [name for name in TURNING if name in excitation.movements and excitation.movements[name].moves]
    asked = [name for name in COMMANDED if name in excitation.movements and excitation.movements[name].moves]
    if excitation.still >= ON_THE_GROUND or not moving:
        return "on the ground, or not flown: nothing that a vehicle turns or lifts itself by moves more than its noise"
    if asked and any("was logged at" in why for why in excitation.lacking.values()):
        return "logged too slowly to show how a vehicle answers"
    if not asked:
        return f"not commanded: {', '.join(moving)} move, but no command does (carried by hand, or not armed)"
    return "not in flight, or not by these commands: the motion does not follow the commands"


def without_ground(log: FlightLog) -> FlightLog:
    """Return a log without its rows on the ground; unchanged if the vehicle never leaves the ground.

    No law of flight describes it. It is cut off at both ends, so that shares of the rows are shares of the flight; in
    between there are gaps. How long it is stands in the notes.
    """
    still = standing_still(log)
    if not still.any() or still.all():
        return log
    note = f"{still.sum() * log.dt:.1f} s on the ground are left out"
    flown = np.flatnonzero(~still)
    part = slice(int(flown[0]), int(flown[-1]) + 1)
    if part.start:
        note += f"; times count from {log.time[part.start]:.2f} s"
    signals = {name: np.where(still, np.nan, values)[part] for name, values in log.signals.items()}
    return replace(log, time=log.time[part] - log.time[part.start], signals=signals, notes=[*log.notes, note])


def without_frozen(log: FlightLog) -> FlightLog:
    """Return a log with NaN where a signal that moves elsewhere stays constant for longer than FROZEN_S.

    No sensor of motion does so for FROZEN_S: its driver or the logger hung. What was left out is in the notes. A thrust
    may be 0 for long.
    """
    signals, notes = dict(log.signals), list(log.notes)
    least = round(FROZEN_S / log.dt)
    for name, values in log.signals.items():
        good = values[np.isfinite(values)]
        if SIGNALS[name].command or name == "thrust" or not (good != good[:1]).any():
            continue
        changes = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0.0, [True]]))
        runs = [(begin, end) for begin, end in itertools.pairwise(changes.tolist()) if end - begin > least]
        if runs:
            signals[name] = values.copy()
            for begin, end in runs:
                signals[name][begin:end] = np.nan
            seconds = sum(end - begin for begin, end in runs) * log.dt
            first = log.time[runs[0][0]]
            notes.append(f"{name}: the same to the last digit for {seconds:.2f} s, first at {first:.2f} s; left out")
    return replace(log, signals=signals, notes=notes) if len(notes) > len(log.notes) else log


def standing_still(log: FlightLog) -> Rows:
    """Return a mask (T,) of a log's rows at rest: no signal moves beyond its noise floor, and throttle is low.

    Throttle is low if it is below half of what it usually is while something moves. Where attitude, vertical velocity
    or throttle are not logged, a time on the ground cannot be told from quiet flight, and there are no such rows unless
    nothing moves in the whole log.
    """
    count = len(log.time)
    length = max(1, round(STILL_S / log.dt))
    moving = np.zeros(count, bool)
    for name, values in log.signals.items():
        if SIGNALS[name].command:
            continue
        limit = max(FLOORS[name], 1.5 * noise_of(values))
        for begin in range(0, count, length):
            part = values[begin : begin + length]
            part = part[np.isfinite(part)]
            # A trend counts as motion; what is left of a second at the end is as long as it is.
            moving[begin : begin + length] |= bool(len(part) > 1 and np.std(part) > limit)
    if not moving.any():
        return np.ones(count, bool)
    throttle = log.signals.get("throttle")
    if throttle is None or not {"roll", "velocity_down"} <= set(log.signals) or not np.isfinite(throttle[moving]).any():
        return np.zeros(count, bool)
    usual = float(np.nanmedian(throttle[moving]))
    return ~moving & (np.nan_to_num(throttle, nan=np.inf) < 0.5 * usual)
