"""Shared by all tasks: axes of actions, the agents' fleet, and the vehicles' own estimates."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.control import Estimate
from qrsim.core.tree import parameter, setting
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError, did_you_mean
from qrsim.world.sensing import measured_quantities
from qrsim.world.state import Action, Fleet, FleetState, State, World

# Denominator of a period in seconds, at most. Periods are multiples of the time step, such as 1/50 s.
LARGEST_DENOMINATOR = 1_000_000


@dataclass(frozen=True)
class Axis:
    """One number of an action or an observation.

    Attributes:
        name: what it is.
        unit: of the number.
        low, high: its range; an agent says -1 for low and 1 for high.
        neutral: what 0 of an action means, () or a float, such as the throttle of hover; between 0 and -1 or 1 it is
            linear. None: the middle of the range.
    """

    name: str
    unit: str
    low: float = -float("inf")
    high: float = float("inf")
    neutral: Any = None

    @property
    def centre(self) -> Any:
        """Place of ``neutral`` in the range (), from -1 to 1; 0 is the middle."""
        return 0.0 if self.neutral is None else 2.0 * (self.neutral - self.low) / (self.high - self.low) - 1.0

    def action(self, value: Any) -> Any:
        """Return the numbers in [-1, 1] of an action for values (...) in units, limited to the range; NumPy."""
        place = np.clip(2.0 * (value - self.low) / (self.high - self.low) - 1.0, -1.0, 1.0)
        if self.neutral is None:
            return place
        away = place - float(self.centre)
        width = np.where(away >= 0.0, 1.0 - float(self.centre), 1.0 + float(self.centre))
        return np.divide(away, width, out=np.zeros_like(width), where=width > 0.0)


def still(axes: tuple[Axis, ...]) -> tuple[float, ...]:
    """Return the action in [-1, 1] that asks for nothing: hover throttle, full battery, else 0 in units."""

    def number(axis: Axis) -> float:
        """Return the number of one axis."""
        if axis.neutral is not None:
            return 0.0
        return float(axis.action(axis.high if axis.name == "battery" else 0.0))

    return tuple(map(number, axes))


def penalty() -> Array:
    """Declare a record's field: the reward of the step in which a vehicle stops, such as after a crash."""
    return parameter(default=-1000.0, unit="1", doc="reward of the step in which a vehicle's flight ends", maximum=0.0)


def leaving() -> bool:
    """Declare a record's field: whether an agent that stops leaves the episode (True) or ends it (False)."""
    return setting(
        default=False,
        doc="an agent that stops leaves with the penalty, and the others continue; if false, the episode ends",
    )


def action_period(seconds: float) -> float:
    """Declare a record's field: the time [s] between two actions of an agent, by default ``seconds``."""
    return setting(default=seconds, unit="s", doc="time between two actions, a multiple of the time step", above=0.0)


def duration_of(steps: Array, period: float, like: Array) -> Array:
    """Return the duration () [s] of ``steps`` () periods [s], of the type of ``like``.

    A period such as 0.02 s is taken as the ratio 1/50 s, because integers are exact in single precision, and it is not.
    """
    if like.dtype == jnp.float64:
        return steps * jnp.asarray(period, like.dtype)
    ratio = Fraction(period).limit_denominator(LARGEST_DENOMINATOR)
    return jnp.asarray(steps, like.dtype) * ratio.numerator / ratio.denominator


def velocity_axes(limit: float, axes: str) -> tuple[Axis, ...]:
    """Return a description of velocity components as action axes, for ``axes`` such as "ned", within +-limit [m/s]."""
    names = {"n": "velocity_north", "e": "velocity_east", "d": "velocity_down"}
    return tuple(Axis(names[axis], "m/s", -limit, limit) for axis in axes)


def number_of(world: World, name: str) -> int:
    """Return the index of the fleet with this name in a world; raise UsageError for an unknown name.

    Raises:
        UsageError: there is none of that name.
    """
    names = [fleet.name for fleet in world.fleets]
    if name not in names:
        raise UsageError(f"no fleet is called '{name}'{did_you_mean(name, names)}")
    return names.index(name)


def fleet_of(world: World, state: State, name: str) -> tuple[Fleet, FleetState]:
    """Return the parameters and the state of the fleet with this name."""
    number = number_of(world, name)
    return world.fleets[number], state.fleets[number]


def only(world: World, name: str, action: Action) -> tuple[Action, ...]:
    """Return one action per fleet of the world: ``action`` for the fleet with this name, None for the others."""
    return tuple(action if fleet.name == name else None for fleet in world.fleets)


def all_fly(state: State) -> Array:
    """Return whether no vehicle of a world has stopped, () bool."""
    return jnp.all(jnp.concatenate([fleet.violation.code for fleet in state.fleets]) == 0)


def estimate_of(state: FleetState) -> Estimate:
    """Return each vehicle's estimate (n,) from its sensors, with its controller's estimate for missing readings."""
    measured, known = measured_quantities(state.readings), state.estimate
    position, velocity = (
        measured.get("position_ned", known.position_ned),
        measured.get("velocity_ned", known.velocity_ned),
    )
    height, rate = measured.get("height", -known.position_ned.z), measured.get("height_rate", -known.velocity_ned.z)
    said = Estimate(
        Vec3(position.x, position.y, -height),
        Vec3(velocity.x, velocity.y, -rate),
        measured.get("attitude", known.attitude),
    )
    return jax.tree.map(lambda new, old: jnp.where(jnp.isfinite(new), new, old), said, known)


def believed(state: FleetState) -> Array:
    """Return each vehicle's estimated state (n, 9): position NED [m], velocity NED [m/s], roll, pitch, yaw [rad]."""
    estimate = estimate_of(state)
    parts = [*jax.tree.leaves(estimate.position_ned), *jax.tree.leaves(estimate.velocity_ned)]
    return jnp.stack([*parts, *jax.tree.leaves(estimate.attitude)], axis=-1)


BELIEVED = (
    *(Axis(f"position_{axis}", "m") for axis in ("north", "east", "down")),
    *(Axis(f"velocity_{axis}", "m/s") for axis in ("north", "east", "down")),
    *(Axis(angle, "rad") for angle in ("roll", "pitch", "yaw")),
)


def square(vector: Vec3) -> Array:
    """Return the squared length of each vector."""
    return vector.dot(vector)
