"""A flight as input of a smoother: states at a reduced rate, and all commands between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array, lax

from qrsim.core.noise import Drawn
from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.engine.settings import quick_jit
from qrsim.errors import RunError, UsageError
from qrsim.models.vehicles.quadrotor import Command, Quadrotor, QuadrotorState

Floats = npt.NDArray[np.float64]
POSITION, ATTITUDE, VELOCITY, RATES, THRUST = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), 12
SIZE = 13


@dataclass(frozen=True)
class Flight:
    """A flight of one vehicle as T + 1 states with ``ticks`` simulator steps from each to the next.

    Attributes:
        name: of the run or of the noise, for messages and figures.
        time_step: of the simulator [s].
        ticks: K, steps between two states.
        vehicle: its model, float64.
        commands: (T, K, 5) as flown: pitch, roll [rad], throttle, yaw rate [rad/s], battery [V].
        air_ned: (T, K, 3) mean wind, known as the commands are [m/s].
        truth: (T + 1, 13) position NED, Euler angles, velocity and rates in body axes, thrust.
        estimate: (T + 1, 13) the same as the vehicle's sensors have it; the thrust follows from the commands.
        fixes: (T + 1, 2) north and east of the GNSS fix made at a state [m], NaN where none was.
    """

    name: str
    time_step: float
    ticks: int
    vehicle: Quadrotor
    commands: Floats
    air_ned: Floats
    truth: Floats
    estimate: Floats
    fixes: Floats

    @property
    def time(self) -> Floats:
        """Time (T + 1,) of each state since the first one [s]."""
        return self.time_step * self.ticks * np.arange(len(self.truth), dtype=np.float64)

    @property
    def fix_error(self) -> Floats:
        """GNSS errors (F, 2), north and east, at the F times of fixes [m]."""
        error = self.fixes - self.truth[:, :2]
        return error[np.isfinite(error).all(axis=1)]

    @property
    def fix_period(self) -> float:
        """Median interval between GNSS fixes [s]; raises RunError for fewer than two fixes."""
        epochs = np.flatnonzero(np.isfinite(self.fixes).all(axis=1))
        if len(epochs) < 2:
            raise RunError(f"{self.name}: {len(epochs)} GNSS fixes; at least 2 needed")
        return float(np.median(np.diff(epochs))) * self.ticks * self.time_step

    @property
    def fix_std(self) -> float:
        """Root mean square of the GNSS errors, over both axes [m]; raises RunError without fixes."""
        if not len(self.fix_error):
            raise RunError(f"{self.name}: there is no GNSS fix to measure the error of")
        return float(np.sqrt(np.mean(np.square(self.fix_error))))


@dataclass(frozen=True)
class Believed:
    """The vehicle's own estimate from its sensors at ticks 0 to N, each (N + 1, 3)."""

    position_ned: Floats
    velocity_ned: Floats
    attitude: Floats
    rates_body: Floats


def first_states(flight: Flight, states: int) -> Flight:
    """Return a flight cut to its first ``states`` states."""
    steps, kept = slice(states - 1), slice(states)
    return replace(
        flight,
        commands=flight.commands[steps],
        air_ned=flight.air_ned[steps],
        truth=flight.truth[kept],
        estimate=flight.estimate[kept],
        fixes=flight.fixes[kept],
    )


def ticks_between(period: float, time_step: float, what: str = "state_period") -> int:
    """Convert a period [s] to ticks; raises UsageError, which names it ``what``, unless it is a whole number from 1.

    Raises:
        UsageError: it is not a whole positive number of them.
    """
    ticks = round(period / time_step) if np.isfinite(period) else 0
    if ticks < 1 or abs(ticks * time_step - period) > 1e-9:
        raise UsageError(f"{what}: {period:g} s is not a multiple of the simulator's step, {time_step:g} s")
    return ticks


def make_flight(
    name: str,
    time_step: float,
    ticks: int,
    vehicle: Quadrotor,
    truth: Floats,
    believed: Believed,
    commands: Floats,
    air_ned: Floats,
    fixes: tuple[npt.NDArray[np.int64], Floats],
) -> Flight:
    """Build a flight from records at each tick, cut to a whole number of intervals of ``ticks`` ticks.

    Args:
        name, time_step, ticks: see Flight.
        vehicle: its model in any precision.
        truth: (N + 1, 13).
        believed: NaN where a sensor had nothing to say.
        commands, air_ned: (N + 1, 5) and (N + 1, 3): row i is of the step that ends at tick i.
        fixes: ticks (F,) and north and east (F, 2) [m].

    Raises:
        UsageError: shorter than two states.
    """
    count = (len(truth) - 1) // ticks
    if count < 1:
        raise UsageError(f"{name}: {len(truth) - 1} ticks are too few for two states {ticks} ticks apart")
    last = count * ticks + 1
    exact = cast(vehicle, np.float64)
    between = commands[1:last].reshape(count, ticks, 5)
    air = air_ned[1:last].reshape(count, ticks, 3)
    sensed = [_filled(part[:last:ticks], name) for part in vars(believed).values()]
    position, velocity, attitude, rates = sensed
    start = np.concatenate([position[0], attitude[0], np.zeros(6), truth[0, THRUST:]])
    thrust = dead_reckon(exact, start, between, air, time_step)[:, THRUST:]
    body = to_body(attitude, velocity)
    at_states = np.full((count + 1, 2), np.nan)
    epochs, places = fixes
    on_state = (epochs % ticks == 0) & (epochs < last)
    at_states[epochs[on_state] // ticks] = places[on_state]
    estimate = np.concatenate([position, attitude, body, rates, thrust], axis=1)
    return Flight(name, time_step, ticks, exact, between, air, truth[:last:ticks], estimate, at_states)


def _filled(values: Floats, name: str) -> Floats:
    """Return a sensor's values (T, 3) with NaN rows replaced by the last known row, as a controller would use them."""
    known = np.isfinite(values).all(axis=1)
    if not known.any():
        raise RunError(f"{name}: a sensor that the estimate needs never had a reading")
    index = np.maximum.accumulate(np.where(known, np.arange(len(values)), np.argmax(known)))
    return values[index]


def to_body(attitude: Floats, velocity_ned: Floats) -> Floats:
    """Rotate velocities (T, 3) from NED into body axes by Euler angles (T, 3)."""
    with jax.enable_x64(True):
        turned = rotation(Euler(*map(jnp.asarray, attitude.T))).to_body(Vec3.of(jnp.asarray(velocity_ned)))
        return np.asarray(turned.stack())


def unpacked(x: Array) -> QuadrotorState:
    """Convert a state vector (13,) to the vehicle model's state."""
    return QuadrotorState(Vec3.of(x[POSITION]), Euler(*x[ATTITUDE]), Vec3.of(x[VELOCITY]), Vec3.of(x[RATES]), x[THRUST])


def advance(vehicle: Quadrotor, x: Array, commands: Array, air_ned: Array, normals: Array, time_step: float) -> Array:
    """Advance a state vector (13,) by K ticks of the vehicle model, with process noise ``normals`` (K, 6).

    Args:
        vehicle: its model.
        x: position, attitude, velocity, rates and thrust, as ``unpacked``.
        commands: (K, 5), the fields of ``Command`` in order.
        air_ned: (K, 3) [m/s].
        normals: (K, 6) standard normals of the process noise.
        time_step: [s].
    """

    def tick(state: QuadrotorState, inputs: tuple[Array, Array, Array]) -> tuple[QuadrotorState, None]:
        """Advance the state by one tick of the vehicle model."""
        command, air, normal = inputs
        noise = vehicle.draw_noise(Drawn(tuple(normal)), time_step)
        wind = Vec3.of(air)
        after, _ = vehicle.step(state, Command(*command), lambda trig: trig.rotation().to_body(wind), noise, time_step)
        return after, None

    final, _ = lax.scan(tick, unpacked(x), (commands, air_ned, normals))
    return jnp.stack(jax.tree.leaves(final))


@partial(quick_jit, static_argnums=4)
def _propagate(vehicle: Quadrotor, start: Array, commands: Array, air_ned: Array, time_step: float) -> Array:
    """Simulate the states (T, 13) after each row of commands (T, K, 5) by the vehicle model without noise."""

    def forward(x: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        """Advance the state by the K ticks of one row; return it twice, as ``scan`` needs."""
        quiet = jnp.zeros((inputs[0].shape[0], vehicle.normals))
        after = advance(vehicle, x, *inputs, quiet, time_step)
        return after, after

    return lax.scan(forward, start, (commands, air_ned))[1]


def dead_reckon(vehicle: Quadrotor, start: Floats, commands: Floats, air_ned: Floats, time_step: float) -> Floats:
    """Predict states (T + 1, 13) from the start and the commands (T, K, 5) by the vehicle model, without noise."""
    with jax.enable_x64(True):
        after = _propagate(vehicle, jnp.asarray(start), jnp.asarray(commands), jnp.asarray(air_ned), time_step)
        return np.concatenate([start[None], np.asarray(after)])
