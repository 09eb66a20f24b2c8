"""Errors of a solution: those that receivers of type ``gnss`` share, and those of each alone."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp
from qrsim.core.noise import Draw
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.apart import Apart, apart_at, apart_init, apart_step
from qrsim.models.gnss.fixes import GnssState
from qrsim.models.gnss.geometry import Geometry, left_signal
from qrsim.models.gnss.parameters import ReceiverParameters, across, column, times
from qrsim.models.gnss.receivers import SkyState
from qrsim.models.gnss.slots import Slots

# Pairs of numbers: of multipath they are those of the satellites' numbers from here on.
MULTIPATH_PAIRS = 1 << 24


def first_common(
    receiver: ReceiverParameters, now: Geometry, draw: Draw, sky: SkyState
) -> tuple[Vec3, Array | None, Apart | None]:
    """Return the first position error [m] by shared errors, and range errors and error states to keep, or None."""
    slots: Slots = sky.slots
    if slots.own is not None:
        apart = apart_init(slots.own, draw, slots)
        code, ranges = apart_at(slots.own, apart, slots, column(receiver))
        return now.of(code), ranges, apart
    if slots.rough:
        ranges = left_signal(receiver) * sky.range_error[jnp.maximum(slots.places, 0)]
        return now.of(ranges[:, None]), ranges, None
    return now.common(slots.part), None, None


def common_errors(
    receiver: ReceiverParameters, now: Geometry, state: GnssState, draw: Draw, sky: SkyState, same: Array
) -> tuple[Vec3, Vec3, Array | None, Apart | None]:
    """Return the position error by shared errors, its change by carrier phase, and range errors and states to keep."""
    slots: Slots = sky.slots
    if state.apart is None and not slots.rough:
        return now.common(slots.part), now.carried * (receiver.period / slots.knot_s), None, None
    if state.apart is None:
        code = carrier = left_signal(receiver) * sky.range_error[jnp.maximum(slots.places, 0)]
        change = jnp.where(same, carrier - state.ranges, 0.0)[:, None]
        return now.of(code[:, None]), now.of(change), carrier, None
    apart = apart_step(slots.own, state.apart, draw, slots, same, receiver.period)
    code, carrier = apart_at(slots.own, apart, slots, column(receiver))
    return now.of(code), now.of(jnp.where(same[:, None], carrier - state.ranges, 0.0)), carrier, apart


def own_error(now: Geometry, bias: tuple[Array, ...], position_ned: Vec3, fast: Array, slow: Array) -> Vec3:
    """Return the position error (n,) [m] by multipath, inter-system offsets and ionospheric gradients."""
    error = now.of_multipath(fast + slow)
    for part, value in zip(now.systems, bias, strict=True):
        error = error + part * value
    if now.reflected is not None:
        error = error + now.reflected
    return error + now.slope_north * position_ned.x + now.slope_east * position_ned.y


def step_multipath(
    receiver: ReceiverParameters, state: GnssState, draw: Draw, slots: Slots, same: Array, velocity_ned: Vec3
) -> tuple[Array, Array]:
    """Return fast and slow multipath (K, n) of unit variance one period later; drawn again for new satellites."""
    # Not normal, which would take half of a fix's time: the sums over time and satellites are.
    drawn = draw.uniform_pairs(slots.ids + jnp.uint32(MULTIPATH_PAIRS))
    way = velocity_ned.norm() * (receiver.period / receiver.multipath_length)
    found = []
    for before, number, time in zip((state.fast, state.slow), drawn, times(receiver), strict=True):
        decay = exp(-(receiver.period / jnp.asarray(time) + way))
        # Of the decay as it was rounded, so that the variance stays what it is.
        spread = jnp.sqrt((1.0 - decay) * (1.0 + decay))
        found.append(jnp.where(same[:, None], across(decay) * before + across(spread) * number, number))
    return found[0], found[1]
