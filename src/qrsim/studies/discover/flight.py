"""Flying proposals: many short windows of a log at once, in NumPy, because compiling would take longer than flying.

The laws that evolve are the thrust that a throttle asks for, the angular acceleration in roll and pitch (one law for
both), that in yaw, and the drag along body x and y. What binds them together (Euler's angles, gravity, the limit of the
change of thrust) is that of the vehicle model (Symington et al. 2014, eqs. 1-6) and is given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from qrsim.core.arrays import NumpyArray
from qrsim.errors import LogError
from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.studies.flight_logs import FlightLog

Floats = npt.NDArray[np.float64]
# A law's right-hand side: (constants (B, 1) ..., leaves (B, n) ...) -> (B, n).
Rule = Callable[..., Any]

ANGULAR = ("roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate")
VELOCITY = ("velocity_north", "velocity_east", "velocity_down")
COMMANDS = ("pitch_command", "roll_command", "throttle", "yaw_rate_command")
# The leaves of each law beside constants.
LEAVES: dict[str, tuple[str, ...]] = {
    "thrust": ("throttle",),
    "tilt": ("command", "angle", "rate"),
    "yaw": ("command", "rate"),
    "drag": ("velocity",),
}
LEFT_SIDES = {
    "thrust": "wanted thrust [N]",
    "tilt": "d(rate)/dt of roll and pitch [rad/s^2]",
    "yaw": "d(rate)/dt of yaw [rad/s^2]",
    "drag": "drag along body x and y [m/s^2]",
}
SHOWN_BY = {"thrust": "thrust", "tilt": "roll", "yaw": "yaw", "drag": "velocity_north"}
# Added to the commands of roll, pitch and yaw rate; of the log and not of the vehicle. By the law that they go into.
TRIMS = {"tilt": ("roll", "pitch"), "yaw": ("yaw_rate",)}
TRIM_UNITS = {"roll": "rad", "pitch": "rad", "yaw_rate": "rad/s"}
# Rows on either side whose parabola gives a start free of most of the noise.
SMOOTHED = 4


@dataclass(frozen=True)
class Flight:
    """A log cut into windows.

    Attributes:
        names: the measured channels.
        start: (10, n) roll, pitch, yaw, p, q, r, u, v, w, thrust at the first row of each window; 0 where not measured.
        commands: (4, H, n) pitch, roll, throttle, yaw rate.
        recorded: (C, H, n) channels after each step.
        dt: step [s].
    """

    names: tuple[str, ...]
    start: Floats
    commands: Floats
    recorded: Floats
    dt: float

    @property
    def laws(self) -> tuple[str, ...]:
        """Names of the laws that the flight's channels depend on."""
        return tuple(law for law in LEAVES if SHOWN_BY[law] in self.names)


def channels_of(log: FlightLog) -> tuple[str, ...]:
    """Return the names of a log's measured channels (angles, rates, thrust, velocity) that laws can be fitted to.

    Raises:
        LogError: neither rotation nor thrust is complete.
    """
    names: tuple[str, ...] = ()
    if any(name in log.signals for name in ANGULAR) or "thrust" not in log.signals:
        log.require((*ANGULAR, "pitch_command", "roll_command", "yaw_rate_command"), "the laws of rotation")
        names = ANGULAR
    if "thrust" in log.signals:
        log.require(("throttle",), "the law of thrust")
        names += ("thrust",)
        if names[0] == "roll" and all(name in log.signals for name in VELOCITY):
            names += VELOCITY
    return names


def windows_of(log: FlightLog, first: float, last: float, steps: int, most: int) -> Flight:
    """Cut at most ``most`` windows of ``steps`` rows, evenly spread over rows ``first`` to ``last`` (fractions) of a
    log.

    Raises:
        LogError: no window without a gap.
    """
    names = channels_of(log)
    needed = [*names, *(name for name in COMMANDS if name in log.signals)]
    good: Any = np.isfinite(np.stack([log.signals[name] for name in needed])).all(axis=0)
    begin, end = round(first * len(good)), round(last * len(good))
    runs = np.cumsum(np.concatenate([[0], good]))
    margin = SMOOTHED if end - begin > steps + 2 * SMOOTHED else 0
    starts = np.arange(begin + margin, end - steps - margin)
    whole = runs[starts + steps + 1 + margin] - runs[starts - margin] == steps + 1 + 2 * margin
    starts = starts[whole]
    if not len(starts):
        raise LogError(f"{log.source}: too short: no {steps * log.dt:g} s without a gap in rows {begin} to {end}")
    starts = starts[np.unique(np.linspace(0, len(starts) - 1, min(most, len(starts))).astype(int))]
    rows = starts[None, :] + np.arange(steps)[:, None]
    zero = np.zeros(len(log.time))
    commands = np.stack([log.signals.get(name, zero)[rows] for name in COMMANDS])
    recorded = np.stack([log.signals[name][rows + 1] for name in names])
    return Flight(names, _starts(log, names, starts, margin), commands, recorded, log.dt)


def _starts(log: FlightLog, names: tuple[str, ...], rows: NumpyArray, margin: int) -> Floats:
    """Return the initial states (10, n) at rows, smoothed by parabolas over ``margin`` rows on each side."""
    start = np.zeros((10, len(rows)))
    offsets = np.arange(-margin, margin + 1)
    # The first row of the pseudo-inverse gives a parabola's value in the middle.
    middle = np.linalg.pinv(np.stack([offsets**0, offsets, offsets**2], axis=1).astype(float))[0]
    smooth = {name: middle @ log.signals[name][rows[None, :] + offsets[:, None]] for name in names}
    for place, name in enumerate(ANGULAR):
        start[place] = smooth.get(name, np.zeros(len(rows)))
    if "thrust" in names:
        start[9] = smooth["thrust"]
    if VELOCITY[0] in names:
        start[6:9] = _turned(start[:3], np.stack([smooth[name] for name in VELOCITY]), to_body=True)
    return start


def _turned(angles: NumpyArray, vector: NumpyArray, to_body: bool) -> NumpyArray:
    """Rotate vectors (3, ...) by Euler angles (3, ...) from NED into body axes; ``to_body`` False: back."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    rows = (
        (cp * cy, cp * sy, -sp),
        (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp),
        (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp),
    )
    if to_body:
        return np.stack([row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2] for row in rows])
    return np.stack([sum(rows[i][k] * vector[i] for i in range(3)) for k in range(3)])


def fly(
    flight: Flight,
    rules: Mapping[str, Rule],
    constants: Mapping[str, Floats],
    mass: float,
    trims: Mapping[str, Floats | float] | None = None,
) -> Floats:
    """Simulate all windows with B sets of constants by Heun's method; return channels (C, H, B, n).

    Args:
        flight: windows.
        rules: by the law's name.
        constants: by the law's name, (K, B) each.
        mass: [kg].
        trims: by name, a number or (B,) each; 0 where there is none.
    """
    batch = max([1, *(c.shape[1] for c in constants.values())])
    added = trims or {}
    offset = [np.reshape(added.get(name, 0.0), (-1, 1)) for name in ("pitch", "roll", "", "yaw_rate")]
    state = np.broadcast_to(flight.start[:, None, :], (10, batch, flight.start.shape[1])).copy()
    fixed = {name: tuple(row[:, None] for row in constants[name]) for name in rules}
    moving = VELOCITY[0] in flight.names
    vehicle = Quadrotor()
    found = []
    with np.errstate(all="ignore"):
        for step in range(flight.commands.shape[1]):
            asked = [row + trim for row, trim in zip(flight.commands[:, step], offset, strict=True)]

            def slope(now: Floats, asked: list[Floats] = asked) -> Floats:
                """Return the derivative of the state ``now`` under one row of commands."""
                return _state_rate(now, asked, rules, fixed, flight.dt, mass, moving, vehicle)

            first = slope(state)
            state = state + 0.5 * flight.dt * (first + slope(state + flight.dt * first))
            found.append(_channels(state, flight.names))
    return np.stack(found, axis=1)


def _state_rate(
    now: Floats,
    asked: list[Floats],
    rules: Mapping[str, Rule],
    fixed: Any,
    dt: float,
    mass: float,
    moving: bool,
    vehicle: Quadrotor,
) -> Floats:
    """Return the derivative (10, ...) of the state under laws ``rules``; ``moving``: velocity counts."""
    change = np.zeros_like(now)
    roll, pitch, _, p, q, r, u, v, w, thrust = now
    if "tilt" in rules:
        sr, cr = np.sin(roll), np.cos(roll)
        cp = np.cos(pitch)
        around = q * sr + r * cr
        change[0], change[1], change[2] = p + around * np.sin(pitch) / cp, q * cr - r * sr, around / cp
        change[3] = rules["tilt"](*fixed["tilt"], asked[1], roll, p)
        change[4] = rules["tilt"](*fixed["tilt"], asked[0], pitch, q)
        change[5] = rules["yaw"](*fixed["yaw"], asked[3], r)
    if "thrust" in rules:
        wanted = rules["thrust"](*fixed["thrust"], asked[2])
        change[9] = np.clip((wanted - thrust) / dt, -vehicle.tau1, vehicle.tau1)
    if moving:
        g = 9.81
        lift = (thrust + dt * change[9]) / mass
        change[6] = rules["drag"](*fixed["drag"], u) - g * np.sin(pitch) + r * v - q * w
        change[7] = rules["drag"](*fixed["drag"], v) + g * sr * cp + p * w - r * u
        change[8] = vehicle.kw * w - lift + g * cr * cp + q * u - p * v
    return change


def _channels(state: Floats, names: tuple[str, ...]) -> Floats:
    """Return the measured channels (C, ...), those named, of a state (10, ...)."""
    parts = []
    if "roll" in names:
        parts.append(state[:6])
    if "thrust" in names:
        parts.append(state[9:])
    if VELOCITY[0] in names:
        parts.append(_turned(state[:3], state[6:9], to_body=False))
    return np.concatenate(parts)
