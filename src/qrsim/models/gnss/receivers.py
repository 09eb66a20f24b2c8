"""GNSS: a sky shared by all vehicles of a world, receivers, and the navigation solution.

See docs/explanation/models/gnss.md.

The receivers of a world see the same satellites with the same time-correlated range errors, so vehicles
near each other share most of their position error, as they do outdoors.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import sincos
from qrsim.core.noise import Draw, ou_step
from qrsim.core.pairs import added
from qrsim.core.tree import parameter, quantity, record, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.contracts import RangeErrors, Sky
from qrsim.models.gnss.orbits import Orbits
from qrsim.models.scene.contracts import Ground
from qrsim.models.sensors.contracts import Memoryless, Sensor

# Position and clock are four unknowns.
FEWEST_SATELLITES = 4


@record
class OrnsteinUhlenbeckErrors(RangeErrors):
    """One Ornstein-Uhlenbeck range error per satellite: ionosphere, troposphere, ephemeris and clock in one.

    The defaults are the reference implementation's: 0.1746 m per step of 0.2 s, 12.35 m stationary.
    """

    std: Array = parameter(default=12.35, unit="m", doc="stationary std of each satellite's range error", minimum=0.0)
    time_constant: Array = parameter(default=2000.0, unit="s", doc="time constant of the range errors", above=0.0)

    def init(self, draw: Draw) -> Array:
        """Return random initial range errors (S,) [m] of S satellites, in the statistical steady state."""
        return self.std * draw.normals(1)[0]

    def step(self, error: Array, draw: Draw, dt: float) -> Array:
        """Return the range errors (S,) [m] dt [s] later."""
        return ou_step(error, draw.normals(1)[0], dt, self.std, self.time_constant)

    def value(self, error: Array) -> Array:
        """Return the range errors (S,) [m] of a state, which is these errors themselves."""
        return error


@record
class SkyState:
    """The space segment at one epoch; S satellites."""

    satellites_ned: Vec3 = quantity(unit="m", doc="(S,) satellite positions at transmission, in the site's frame")
    range_error: Array = quantity(unit="m", doc="(S,) error of each satellite's pseudorange, common to all receivers")
    range_rate_error: Array = quantity(default=None, unit="m/s", doc="(S,) its mean rate over the last period")
    memory: Any = quantity(default=None, doc="state of the range errors")
    ids: Array = quantity(default=None, doc="(S,) uint32 number of each satellite")
    slots: Any = quantity(default=None, doc="satellites in view, for receivers of type gnss; None without any")


@record
class SharedSky(Sky):
    """The shared space segment."""

    orbits: Orbits = quantity(doc="satellite positions as seen from the site")
    errors: RangeErrors = quantity(doc="range errors")
    ids: Array = quantity(doc="(S,) uint32 number of each satellite, which its randomness belongs to")
    period: float = setting(
        default=0.2, unit="s", doc="interval between epochs, a multiple of the time step", above=0.0
    )

    def init(self, draw: Draw) -> SkyState:
        """Return the state of satellites and range errors at the start; ``draw`` is for the S satellites."""
        start = self.orbits.positions_ned(jnp.int32(0), jnp.zeros_like(draw.like))
        memory = self.errors.init(draw)
        error = self.errors.value(memory)
        return SkyState(start, error, jnp.zeros_like(error), memory, self.ids)

    def step(self, state: SkyState, draw: Draw, seconds: Array, fraction: Array) -> SkyState:
        """Return the state of satellites and range errors one epoch later, at a time in the run."""
        memory = self.errors.step(state.memory, draw, self.period)
        error = self.errors.value(memory)
        rate = (error - state.range_error) * (1.0 / self.period)
        return SkyState(self.orbits.positions_ned(seconds, fraction), error, rate, memory, self.ids)


@record
class GnssReading:
    """Reading of a receiver; NaN without a fix."""

    position_ned: Vec3 = quantity(unit="m", doc="position in the site's frame")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity over ground")
    satellites: Array = quantity(unit="1", doc="satellites used")
    hdop: Array = quantity(unit="1", doc="horizontal dilution of precision")
    vdop: Array = quantity(unit="1", doc="vertical dilution of precision")


@record
class Fix:
    """One navigation solution."""

    offset_ned: Vec3 = quantity(unit="m", doc="solution minus true position")
    satellites: Array = quantity(unit="1", doc="satellites used")
    hdop: Array = quantity(unit="1", doc="horizontal dilution of precision")
    vdop: Array = quantity(unit="1", doc="vertical dilution of precision")


def solve_position(line_of_sight: Vec3, range_residual: Array, used: Array) -> Fix:
    """Return the least-squares fix of position and receiver clock from range residuals [m] of S satellites.

    The residual form: rho_i - |p_i - p| = -u_i . d + c dt, with d the offset from the true position p in NED.
    The neglected term is d^2 / (2 rho): 1e-5 m at 20 m. The clock is eliminated by taking means over the used
    satellites, which leaves symmetric 3 x 3 equations in closed form.

    Args:
        line_of_sight: unit vectors from receiver to satellite, (S, n) each.
        range_residual: pseudorange minus geometric range, (S, n) [m].
        used: (S, n) bool.

    Returns:
        The fix of each receiver, (n,); NaN where fewer than 4 satellites are used.
    """
    weight = used.astype(range_residual.dtype)
    count = jnp.sum(weight, axis=0)

    def centred(value: Array) -> Array:
        """Return values minus their mean over the used satellites, and 0 for unused ones."""
        # Selected, not multiplied by the weight, because a satellite without a position is NaN.
        mean = jnp.sum(jnp.where(used, value, 0.0), axis=0) / jnp.maximum(count, 1.0)
        return jnp.where(used, value - mean[None, :], 0.0)

    ux, uy, uz = centred(line_of_sight.x), centred(line_of_sight.y), centred(line_of_sight.z)
    residual = centred(range_residual)
    inverse = _inverse_symmetric(
        *(jnp.sum(a * b, axis=0) for a, b in ((ux, ux), (ux, uy), (ux, uz), (uy, uy), (uy, uz), (uz, uz)))
    )
    xx, xy, xz, yy, yz, zz = inverse

    def solved(residual: Array) -> Vec3:
        """Return the least-squares position error (n,) [m] for range residuals (S, n) [m]."""
        bx, by, bz = (-jnp.sum(u * residual, axis=0) for u in (ux, uy, uz))
        return Vec3(xx * bx + xy * by + xz * bz, xy * bx + yy * by + yz * bz, xz * bx + yz * by + zz * bz)

    first = solved(residual)
    # Solved again for what is left, because single precision loses some of it where the geometry is weak.
    offset = first + solved(centred(range_residual + line_of_sight.dot(first.map(lambda axis: axis[None, :]))))
    enough = count >= FEWEST_SATELLITES

    def or_nan(value: Array) -> Array:
        """Return a value (n,), NaN for receivers with too few satellites for a fix."""
        return jnp.where(enough, value, math.nan)

    return Fix(
        offset.map(or_nan),
        count,
        or_nan(jnp.sqrt(jnp.maximum(xx + yy, 0.0))),
        or_nan(jnp.sqrt(jnp.maximum(zz, 0.0))),
    )


def _inverse_symmetric(a: Array, b: Array, c: Array, d: Array, e: Array, f: Array) -> tuple[Array, ...]:
    """Return the inverse of symmetric [[a, b, c], [b, d, e], [c, e, f]] by cofactors, as the same six entries."""
    co_a, co_b, co_c = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * co_a + b * co_b + c * co_c)
    return (
        co_a * scale,
        co_b * scale,
        co_c * scale,
        (a * f - c * c) * scale,
        (b * c - a * e) * scale,
        (a * d - b * b) * scale,
    )


@record
class ReceiverState:
    """State of a receiver: the last fix, and the fixes not delivered yet."""

    position_ned: Vec3 = quantity(unit="m", doc="last solution")
    true_ned: Any = quantity(unit="m", doc="true position at the last solution; None for a solution of two parts")
    pending: tuple[GnssReading, ...] = quantity(doc="readings that the delay holds back, oldest first")
    listed: Array | None = quantity(default=None, doc="(S, n) bool: satellites kept of the hand list, else None")
    position_low_ned: Any = quantity(
        default=None, unit="m", doc="remainder of position_ned beyond single precision, or None"
    )


# The satellites "from a typical flight day" of the reference implementation; each receiver keeps 10 to 13 of them.
HAND_LIST = (3, 5, 6, 7, 13, 16, 18, 19, 20, 22, 24, 29, 31)
FEWEST_LISTED = 10
ABSENT_HEIGHT = 2.66e7


@record
class GnssReceiver(Sensor):
    """A single-frequency receiver: all satellites above a mask, solved by least squares.

    ``velocity: differenced`` is the published one, from successive fixes; ``doppler`` solves range rates, whose errors
    are the drift of the range errors and white noise. ``satellites: hand_list`` is the published choice: a random 10
    to 13 of a fixed list, also below the horizon; it needs satellites with PRN numbers (an SP3 file).
    """

    range_noise_std: Array = parameter(default=0.002, unit="m", doc="white noise of each pseudorange", minimum=0.0)
    elevation_mask_rad: Array = parameter(
        default=math.radians(10.0),
        unit="rad",
        doc="satellites below this elevation are not used",
        minimum=0.0,
        maximum=math.pi / 2,
    )
    doppler_noise_std: Array = parameter(
        default=0.05, unit="m/s", doc="white noise of each range rate, for velocity 'doppler'", minimum=0.0
    )
    delay: int = setting(default=1, unit="periods", doc="age of a fix at its report", minimum=0, maximum=50)
    velocity: Literal["differenced", "doppler"] = setting(
        default="differenced", doc="source of the velocity: Doppler shifts, or differenced positions"
    )
    satellites: Literal["mask", "hand_list"] = setting(default="mask", doc="satellites in the solution")
    period: float = setting(
        default=0.2, unit="s", doc="interval between fixes, a multiple of the sky's period", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "velocity_ned", "sky", "position_low_ned", "ground")
    draws_alone: ClassVar[bool] = True

    def init(
        self,
        draw: Draw,
        position_ned: Vec3,
        velocity_ned: Vec3,
        sky: SkyState,
        position_low_ned: Vec3 | None = None,
        ground: Ground | None = None,
    ) -> tuple[ReceiverState, GnssReading]:
        """Return state and first fix of receivers that have been running, with the true velocity."""
        listed = self._choose_listed(draw, sky) if self.satellites == "hand_list" else None
        fix, _ = self._solve(draw, position_ned, sky, listed, ground)
        position, true, low = _solution(position_ned, fix, position_low_ned)
        reading = GnssReading(position, velocity_ned, fix.satellites, fix.hdop, fix.vdop)
        return ReceiverState(position, true, (reading,) * self.delay, listed, low), reading

    def restart(
        self,
        state: ReceiverState,
        draw: Draw,
        since: Array,
        position_ned: Vec3,
        velocity_ned: Vec3,
        sky: SkyState,
        position_low_ned: Vec3 | None = None,
        ground: Ground | None = None,
    ) -> tuple[ReceiverState, GnssReading]:
        """Return state and first fix of receivers that were moved to other positions, ``since`` [s] after an epoch."""
        fresh, reading = self.init(draw, position_ned, velocity_ned, sky, position_low_ned, ground)
        # Where they would have been at that epoch, because the next velocity is that of a whole period.
        moved = velocity_ned * since
        if fresh.position_low_ned is None:
            return replace(fresh, position_ned=fresh.position_ned - moved, true_ned=fresh.true_ned - moved), reading
        position, low = added(fresh.position_ned, fresh.position_low_ned - moved)
        return replace(fresh, position_ned=position, position_low_ned=low), reading

    def step(
        self,
        state: ReceiverState,
        draw: Draw,
        position_ned: Vec3,
        velocity_ned: Vec3,
        sky: SkyState,
        position_low_ned: Vec3 | None = None,
        ground: Ground | None = None,
    ) -> tuple[ReceiverState, GnssReading]:
        """Return the receivers' state after an epoch at ``position_ned`` (n,) [m], and the fix ``delay`` epochs old."""
        fix, velocity_error = self._solve(draw, position_ned, sky, state.listed, ground)
        position, true, low = _solution(position_ned, fix, position_low_ned)
        if velocity_error is not None:
            velocity = velocity_ned + velocity_error
        else:
            # What a sum of truth and error loses to rounding would be divided by the period.
            if low is None:
                moved = (position_ned - state.true_ned) + (fix.offset_ned - (state.position_ned - state.true_ned))
            else:
                moved = (position - state.position_ned) + (low - state.position_low_ned)
            velocity = moved * (1.0 / self.period)
        fresh = GnssReading(position, velocity, fix.satellites, fix.hdop, fix.vdop)
        queue = (*state.pending, fresh)
        return ReceiverState(position, true, queue[1:], state.listed, low), queue[0]

    def fix(self, draw: Draw, position_ned: Vec3, sky: SkyState) -> Fix:
        """Return the position fix of each receiver (n,) from the satellites above its elevation mask."""
        return self._solve(draw, position_ned, sky, None, None)[0]

    def _solve(
        self, draw: Draw, position_ned: Vec3, sky: SkyState, listed: Array | None, ground: Ground | None
    ) -> tuple[Fix, Vec3 | None]:
        """Return each receiver's (n,) fix, and the error of its velocity for the setting 'doppler', else None."""
        # A satellite without a position is put somewhere and not used, so that no NaN comes near a gradient.
        present = jnp.isfinite(sky.satellites_ned.z)
        satellites = sky.satellites_ned.map(lambda axis: jnp.where(present, axis, -ABSENT_HEIGHT))
        ray = Vec3(
            satellites.x[:, None] - position_ned.x[None, :],
            satellites.y[:, None] - position_ned.y[None, :],
            satellites.z[:, None] - position_ned.z[None, :],
        )
        line_of_sight = ray * (1.0 / ray.norm())
        shape, count = position_ned.x.shape, sky.range_error.shape[0]
        mask = jnp.broadcast_to(sincos(jnp.asarray(self.elevation_mask_rad))[0], shape)
        used = present[:, None] & (-line_of_sight.z > mask[None, :] if listed is None else listed)
        if ground is not None and ground.hides and listed is None:
            used = used & (-line_of_sight.z > ground.horizon_sine(position_ned, line_of_sight))
        noise = jnp.broadcast_to(jnp.asarray(self.range_noise_std), shape)
        doppler = self.velocity == "doppler"
        normals = draw.normal_rows(2 * count if doppler else count)
        fix = solve_position(line_of_sight, sky.range_error[:, None] + noise[None, :] * normals[:count], used)
        if not doppler:
            return fix, None
        rate_noise = jnp.broadcast_to(jnp.asarray(self.doppler_noise_std), shape)
        rates = sky.range_rate_error[:, None] + rate_noise[None, :] * normals[count:]
        return fix, solve_position(line_of_sight, rates, used).offset_ned

    def _choose_listed(self, draw: Draw, sky: SkyState) -> Array:
        """Return (S, n) bool: each receiver uses 10 to 13 random satellites of ``HAND_LIST``, a fixed list of PRNs."""
        # The lower byte of a number is the PRN.
        prn = sky.ids & jnp.uint32(0xFF)
        on_list = jnp.any(jnp.stack([prn == jnp.uint32(number) for number in HAND_LIST]), axis=0)
        count = sky.range_error.shape[0]
        # Beyond the pairs that a fix uses. The last row says how many to keep, each number equally likely.
        normals = draw.normal_rows(count + 1, first=count)
        quartile = jnp.sum(jnp.stack([normals[count] > edge for edge in (-0.6744898, 0.0, 0.6744898)]), axis=0)
        score = jnp.where(on_list[:, None], normals[:count], -math.inf)
        rank = jnp.sum((score[None, :, :] > score[:, None, :]).astype(jnp.int32), axis=1)
        return on_list[:, None] & (rank < (FEWEST_LISTED + quartile)[None, :])


def _solution(position_ned: Vec3, fix: Fix, position_low_ned: Vec3 | None) -> tuple[Vec3, Vec3 | None, Vec3 | None]:
    """Return the parts of a fix that a state stores: rounded fix, true position or None, rounding remainder or None.

    From a position of two parts comes a solution of two parts, which need not be taken apart into truth and error.
    """
    if position_low_ned is None:
        return position_ned + fix.offset_ned, position_ned, None
    position, low = added(position_ned, fix.offset_ned + position_low_ned)
    return position, None, low


@record
class IdealGnss(Memoryless):
    """The truth at the same period, without delay."""

    period: float = setting(
        default=0.2, unit="s", doc="interval between fixes, a multiple of the sky's period", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "velocity_ned", "sky")
    draws_alone: ClassVar[bool] = True

    def init(self, draw: Draw, position_ned: Vec3, velocity_ned: Vec3, sky: SkyState) -> tuple[None, GnssReading]:
        """Return None as state, and the reading: true position and velocity, all satellites, dilutions 0."""
        zero = jnp.zeros_like(position_ned.x)
        count = jnp.full_like(zero, sky.range_error.shape[0])
        return None, GnssReading(position_ned, velocity_ned, count, zero, zero)
