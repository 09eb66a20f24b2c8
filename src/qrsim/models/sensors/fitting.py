"""Fitting of a sensor to its vehicle: mounting position, orientation, and delay of its readings.

It is the same for all sensors, so no sensor model contains it. The world passes a sensor the true state at its
mounting, and holds its readings back until they are delivered (world/sensing.py).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import arctan2
from qrsim.core.tree import Record, quantity, record, select, setting
from qrsim.core.vectors import Euler, Rotation, Vec3, rotation

# Periods that a reading may be on its way, and the spreads of its delay after which it is there at the latest.
LONGEST_DELAY, LATEST = 50, 6.0


@record
class Fitting:
    """Mounting of a sensor, and the delay of its readings.

    Delays have a gamma distribution of the mean and the spread that are given (Wilson and Hilferty's approximation, at
    most six spreads above the mean), because none can be negative. Readings arrive in the order in which they were
    taken.
    """

    position_body: Vec3 | None = quantity(default=None, unit="m", doc="from the centre of mass; None: there")
    attitude: Euler | None = quantity(default=None, unit="rad", doc="against the body axes; None: along them")
    delay: float = setting(default=0.0, unit="periods", doc="mean time from reading to delivery", minimum=0.0)
    jitter: float = setting(default=0.0, unit="s", doc="std of the time of delivery; 0: constant", minimum=0.0)

    @property
    def is_late(self) -> bool:
        """True if the sensor's readings are delivered with a delay."""
        return self.delay > 0.0

    def slots(self, period: float) -> int:
        """Return how many readings are stored: the most that can be in transit, plus the last delivered one."""
        return math.ceil(round(self.delay + LATEST * self.jitter / period, 9)) + 1

    def ticks(self, period: float, time_step: float, draw: Any, shape: tuple[int, ...]) -> Array:
        """Return the delay (n,) int32 [ticks], with random jitter, of readings taken now."""
        mean = self.delay * period
        if self.jitter == 0.0:
            return jnp.full(shape, round(mean / time_step), jnp.int32)
        spread = self.jitter / mean
        cube = 1.0 - spread * spread / 9.0 + (spread / 3.0) * draw.normals(1)[0]
        late = jnp.clip(mean * (cube * cube * cube), 0.0, mean + LATEST * self.jitter)
        return jnp.round(late * (1.0 / time_step)).astype(jnp.int32)


@record
class Transit:
    """Readings of n vehicles in transit from sensor to user, oldest first."""

    readings: tuple[Record, ...] = quantity(doc="the first has always been delivered")
    taken: tuple[Array, ...] = quantity(doc="(n,) int32 tick at which each was true")
    due: tuple[Array, ...] = quantity(doc="(n,) int32 tick at which each is delivered")

    @staticmethod
    def starting(reading: Record, slots: int, tick: Array, like: Array) -> Transit:
        """Return a store of ``slots`` delayed readings, all the first reading, delivered at ``tick``."""
        now = jnp.broadcast_to(jnp.asarray(tick, jnp.int32), like.shape)
        return Transit((reading,) * slots, (now,) * slots, (now,) * slots)

    def sent(self, reading: Record, tick: Array, ticks: Array) -> Transit:
        """Return the store with a reading added, to be delivered ``ticks`` (n,) later, not before earlier ones."""
        now = jnp.broadcast_to(jnp.asarray(tick, jnp.int32), ticks.shape)
        due = jnp.maximum(now + ticks, self.due[-1])
        return Transit((*self.readings[1:], reading), (*self.taken[1:], now), (*self.due[1:], due))

    def delivered(self, tick: Array) -> Record:
        """Return the newest reading (n,) that has been delivered by a tick."""
        newest = self.readings[0]
        for reading, due in zip(self.readings[1:], self.due[1:], strict=True):
            newest = select(due <= tick, reading, newest)
        return newest

    def time_of_reading(self, tick: Array) -> Array:
        """Return the tick (n,) at which the reading of ``delivered`` was taken."""
        newest = self.taken[0]
        for taken, due in zip(self.taken[1:], self.due[1:], strict=True):
            newest = jnp.where(due <= tick, taken, newest)
        return newest

    def fresh(self, tick: Array) -> Array:
        """Return (n,) bool: a reading is delivered at exactly this tick."""
        arrives = self.due[0] == tick
        for due in self.due[1:]:
            arrives = arrives | (due == tick)
        return arrives


@record
class Fitted:
    """State of a sensor's fitting."""

    transit: Transit | None = quantity(default=None, doc="readings in transit; None without a delay")
    rates_body: Vec3 | None = quantity(
        default=None, unit="rad/s", doc="true rates at the last tick; None where the mounting does not need them"
    )


def start_fitted(
    fitting: Fitting, reads: tuple[str, ...], reading: Record, period: float, tick: Array, rates_body: Vec3
) -> Fitted:
    """Return a fitting's (mounting and delay) state at the start, from first reading and body rates (n,) [rad/s]."""
    transit = None
    if fitting.is_late:
        transit = Transit.starting(reading, fitting.slots(period), tick, rates_body.x)
    lever = fitting.position_body is not None and "specific_force" in reads
    return Fitted(transit, rates_body if lever else None)


def mounted(
    fitting: Fitting, scene: Mapping[str, Any], reads: tuple[str, ...], before: Vec3 | None, dt: float
) -> object:
    """Return a sensor's true inputs ``reads`` by name, moved to its mounting position and into its own axes.

    With r from the centre of mass: position + D^T r, velocity + omega x r, and for the mean specific force of a step
    + omega' x r + omega x (omega x r), with the mean rates of the step and omega' their change over it.

    Args:
        fitting: of the sensor.
        scene: what is true at the centre of mass.
        reads: what the sensor looks at.
        before: rates (n,) [rad/s] one step ago; None: as now.
        dt: step [s].
    """
    found = {item: scene[item] for item in reads}
    lever, turned = fitting.position_body, fitting.attitude
    rates: Vec3 = scene["rates_body"]
    like = rates.x
    if lever is not None:
        arm = lever.map(lambda axis: jnp.broadcast_to(jnp.asarray(axis, like.dtype), like.shape))
        direction = rotation(scene["attitude"])
        swing = rates.cross(arm)
        if "position_ned" in found:
            found["position_ned"] = scene["position_ned"] + direction.to_ned(arm)
        if "velocity_ned" in found:
            found["velocity_ned"] = scene["velocity_ned"] + direction.to_ned(swing)
        if "velocity_body" in found:
            found["velocity_body"] = scene["velocity_body"] + swing
        if "specific_force" in found:
            old = rates if before is None else before
            mean, change = (rates + old) * 0.5, (rates - old) * (1.0 / dt)
            found["specific_force"] = scene["specific_force"] + change.cross(arm) + mean.cross(mean.cross(arm))
    if turned is not None:
        axes = rotation(Euler(*(jnp.asarray(angle, like.dtype) for angle in (turned.roll, turned.pitch, turned.yaw))))
        for name in ("velocity_body", "rates_body", "specific_force"):
            if name in found:
                found[name] = axes.to_body(found[name])
        if "attitude" in found:
            found["attitude"] = _euler(axes, rotation(scene["attitude"]))
    return found


def _euler(axes: Rotation, body: Rotation) -> Euler:
    """Return the Euler angles [rad] of sensor axes, given their rotation relative to the body, and the body's."""
    forward, right, down = (body.to_ned(axis) for axis in (axes.forward, axes.right, axes.down))
    pitch = arctan2(-forward.z, jnp.sqrt(forward.x * forward.x + forward.y * forward.y))
    return Euler(arctan2(right.z, down.z), pitch, arctan2(forward.y, forward.x))
