"""A complementary filter: the accelerometer predicts, GNSS and barometer correct.

See docs/explanation/models/control.md, C16 and C17.

Without a sensor of the attitude, the attitude is estimated too (mahony.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.control.contracts import Estimator
from qrsim.control.mahony import Turning
from qrsim.control.reading_fields import FIELD, field_of, known, source_of
from qrsim.control.setpoints import Estimate
from qrsim.core.fastmath import arctan2
from qrsim.core.pairs import added
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import derived, parameter, quantity, record, replace, setting
from qrsim.core.vectors import Euler, Vec3, rotation


@record
class FilterState:
    """Memory of the filter, (n,)."""

    position_ned: Vec3 = quantity(unit="m", doc="estimated position")
    position_low_ned: Vec3 = quantity(unit="m", doc="remainder of it beyond single precision")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="estimated velocity over ground")
    bias_ned: Vec3 = quantity(unit="m/s^2", doc="estimated error of the measured acceleration")
    attitude: Euler = quantity(unit="rad", doc="last attitude that was measured")
    since_fix: Array = quantity(unit="s", doc="time since the last reading that corrected the place")
    since_height: Array = quantity(unit="s", doc="time since the last reading that corrected the height")
    turning: Turning | None = quantity(
        default=None, doc="state of its attitude filter; None if a sensor measures the attitude"
    )


@record
class ComplementaryFilter(Estimator):
    """Position and velocity from accelerometer, attitude, GNSS and barometer.

    Each reading corrects when it is new, by its gain times the time since the one before it, so that gains do not
    depend on periods. A reading that is missing corrects nothing; without a specific force the velocity is held.
    Nothing is known of a delay. Without a sensor that reports the attitude it is found from gyroscope and
    accelerometer, and the heading from a magnetometer or, of vehicles that fly nose first, from the course.
    """

    position_gain: Array = parameter(
        default=0.5, unit="1/s", doc="horizontal position correction per position error", minimum=0.0
    )
    height_gain: Array = parameter(default=1.5, unit="1/s", doc="height correction per height error", minimum=0.0)
    velocity_gain: Array = parameter(
        default=1.0, unit="1/s", doc="horizontal velocity correction per velocity error", minimum=0.0
    )
    climb_gain: Array = parameter(
        default=0.3, unit="1/s", doc="vertical velocity correction per velocity error", minimum=0.0
    )
    velocity_by_position: Array = parameter(
        default=0.3, unit="1/s", doc="velocity correction per position correction", minimum=0.0
    )
    bias_gain: Array = parameter(
        default=0.05, unit="1/s^2", doc="accelerometer bias correction per velocity error", minimum=0.0
    )
    bias_by_position: Array = parameter(
        default=0.3,
        unit="1/s",
        doc="weight of a position error in the bias correction, relative to a velocity error",
        minimum=0.0,
    )
    gravity: Array = parameter(default=9.81, unit="m/s^2", doc="gravitational acceleration", minimum=0.0)
    longest: Array = parameter(
        default=1.0, unit="s", doc="longest time that one reading corrects for, after missing readings", above=0.0
    )

    tilt_gain: Array = parameter(
        default=0.3, unit="1/s", doc="attitude correction per error of the specific force's direction", minimum=0.0
    )
    heading_gain: Array = parameter(default=0.3, unit="1/s", doc="heading correction per heading error", minimum=0.0)
    gyroscope_bias_gain: Array = parameter(
        default=0.02, unit="1/s^2", doc="gyroscope bias correction per attitude error", minimum=0.0
    )
    heading: Literal["magnetometer", "course"] = setting(
        default="magnetometer", doc="reference of the heading: a magnetometer, if the vehicle has one, or the course"
    )
    course_least: Array = parameter(
        default=3.0, unit="m/s", doc="speed over ground below which the course is ignored", minimum=0.0
    )
    earth_field_ned: Vec3 | None = derived(default=None, doc="the Earth's field at the site [uT]; None: unknown")

    reads: ClassVar[tuple[str, ...]] = ("gnss_receiver", "barometer", "attitude_estimator", "accelerometer")
    instead: ClassVar[Mapping[str, str]] = {"attitude_estimator": "gyroscope"}

    def fitted(self, ages: Mapping[str, int], earth_field_ned: Vec3 | None = None) -> ComplementaryFilter:
        """Return the filter for a site's magnetic field NED [uT]; ``ages``, the sensors' delays, are not used."""
        return replace(self, earth_field_ned=earth_field_ned)

    def init(self, readings: Mapping[str, object], start: Estimate) -> tuple[FilterState, Estimate]:
        """Return state and estimate (n,) from the first readings, or from ``start`` where one is missing."""
        place, velocity = field_of(readings, "position_ned"), field_of(readings, "velocity_ned")
        height, rate, attitude = (field_of(readings, name) for name in ("height", "height_rate", "attitude"))
        position = start.position_ned if place is None else place
        position = replace(position, z=start.position_ned.z if height is None else -height)
        velocity = start.velocity_ned if velocity is None else velocity
        velocity = replace(velocity, z=velocity.z if rate is None else -rate)
        zero = jnp.zeros_like(start.position_ned.x)
        none = Vec3(zero, zero, zero)
        velocity = known(velocity, start.velocity_ned)
        own = attitude is None and field_of(readings, "rates_body") is not None
        state = FilterState(
            known(position, start.position_ned),
            none,
            velocity,
            none,
            start.attitude if attitude is None else known(attitude, start.attitude),
            zero,
            zero,
            Turning.start(Quaternion.of(start.attitude), velocity) if own else None,
        )
        return state, _estimate(state)

    def step(
        self, state: FilterState, readings: Mapping[str, object], fresh: Mapping[str, Array], dt: float
    ) -> tuple[FilterState, Estimate]:
        """Return the state after prediction by dt [s] and correction by new readings (n,), and the estimate (n,)."""
        attitude = field_of(readings, "attitude")
        if attitude is not None:
            state = replace(state, attitude=known(attitude, state.attitude))
        elif state.turning is not None:
            turning = self._turned(state.turning, readings, fresh, dt)
            state = replace(state, turning=turning, attitude=turning.attitude.euler())
        state = self._predicted(state, field_of(readings, "specific_force"), dt)
        state = self._by_fix(state, readings, fresh)
        state = self._by_height(state, readings, fresh)
        return state, _estimate(state)

    def _turned(
        self, turning: Turning, readings: Mapping[str, object], fresh: Mapping[str, Array], dt: float
    ) -> Turning:
        """Return the attitude filter's state after dt [s], by gyroscope, accelerometer and heading (eq. F8)."""
        turning = turning.waited(dt)
        velocity, force = field_of(readings, "velocity_ned"), field_of(readings, "specific_force")
        rates = known(field_of(readings, "rates_body"), turning.rates_body)
        if velocity is not None:
            turning = turning.with_velocity(velocity, fresh[source_of(readings, "velocity_ned")])
        zero = jnp.zeros_like(turning.since_fix)
        tilt = Vec3(zero, zero, zero) if force is None else turning.tilt_error(force, self.gravity)
        error, new = self._heading_error(turning, readings, fresh)
        new = new & jnp.isfinite(error)
        span = jnp.where(new, jnp.minimum(turning.since_heading, self.longest), 0.0)
        heading = jnp.where(new, error, 0.0) * span
        turning = replace(turning, since_heading=jnp.where(new, 0.0, turning.since_heading))
        correction = replace(tilt * (self.tilt_gain * dt), z=self.heading_gain * heading)
        learned = replace(tilt * dt, z=heading) * (-self.gyroscope_bias_gain)
        return turning.turned(rates, correction, learned, dt)

    def _heading_error(
        self, turning: Turning, readings: Mapping[str, object], fresh: Mapping[str, Array]
    ) -> tuple[Array, Array]:
        """Return the heading error (n,) [rad] by magnetometer or course, and (n,) bool: it is from a new reading."""
        nothing = jnp.full_like(turning.since_fix, jnp.nan)
        field, velocity = field_of(readings, FIELD), field_of(readings, "velocity_ned")
        if self.heading == "course" and velocity is not None:
            new = fresh[source_of(readings, "velocity_ned")]
            return turning.course_error(velocity, self.course_least), new & (nothing != 0.0)
        if self.heading == "course" or field is None:
            return nothing, jnp.isfinite(nothing)
        earth = self.earth_field_ned
        declination = 0.0 * self.gravity if earth is None else arctan2(earth.y, earth.x)
        return turning.compass_error(field, declination), fresh[source_of(readings, FIELD)] & (nothing != 0.0)

    def _predicted(self, state: FilterState, force: Vec3 | None, dt: float) -> FilterState:
        """Return the state dt [s] later by the tick's mean specific force (n,) [m/s^2], body axes (eq. C16)."""
        change = Vec3(*(jnp.zeros_like(state.since_fix),) * 3)
        if force is not None:
            felt = rotation(state.attitude).to_ned(force)
            felt = replace(felt, z=felt.z + self.gravity) - state.bias_ned
            seen = jnp.isfinite(felt.x) & jnp.isfinite(felt.y) & jnp.isfinite(felt.z)
            change = felt.map(lambda axis: jnp.where(seen, axis * dt, 0.0))
        way = (state.velocity_ned + 0.5 * change) * dt
        position, low = added(state.position_ned, state.position_low_ned + way)
        return replace(
            state,
            position_ned=position,
            position_low_ned=low,
            velocity_ned=state.velocity_ned + change,
            since_fix=state.since_fix + dt,
            since_height=state.since_height + dt,
        )

    def _by_fix(self, state: FilterState, readings: Mapping[str, object], fresh: Mapping[str, Array]) -> FilterState:
        """Return the state corrected by a GNSS fix's horizontal position and velocity, where it is new (eq. C17)."""
        place, velocity = field_of(readings, "position_ned"), field_of(readings, "velocity_ned")
        if place is None:
            return state
        new = fresh[source_of(readings, "position_ned")] & jnp.isfinite(place.x) & jnp.isfinite(place.y)
        span = jnp.where(new, jnp.minimum(state.since_fix, self.longest), 0.0)
        moved, gained, learned = {}, {}, {}
        for axis in "xy":
            error = getattr(place, axis) - getattr(state.position_ned, axis) - getattr(state.position_low_ned, axis)
            error = jnp.where(new, error, 0.0)
            slip = jnp.zeros_like(error)
            if velocity is not None:
                slip = getattr(velocity, axis) - getattr(state.velocity_ned, axis)
                slip = jnp.where(new & jnp.isfinite(slip), slip, 0.0)
            gains = (self.position_gain, self.velocity_gain)
            moved[axis], gained[axis], learned[axis] = self._corrections(gains, error, slip, span)
        zero = jnp.zeros_like(span)
        state = _corrected(state, *(Vec3(**part, z=zero) for part in (moved, gained, learned)))
        return replace(state, since_fix=jnp.where(new, 0.0, state.since_fix))

    def _by_height(self, state: FilterState, readings: Mapping[str, object], fresh: Mapping[str, Array]) -> FilterState:
        """Return the state corrected by the barometer's height and climb rate, where they are new (eq. C17)."""
        height, rate = field_of(readings, "height"), field_of(readings, "height_rate")
        if height is None:
            return state
        new = fresh[source_of(readings, "height")] & jnp.isfinite(height)
        span = jnp.where(new, jnp.minimum(state.since_height, self.longest), 0.0)
        error = jnp.where(new, -height - state.position_ned.z - state.position_low_ned.z, 0.0)
        slip = jnp.zeros_like(error)
        if rate is not None:
            slip = -rate - state.velocity_ned.z
            slip = jnp.where(new & jnp.isfinite(slip), slip, 0.0)
        zero = jnp.zeros_like(span)
        parts = self._corrections((self.height_gain, self.climb_gain), error, slip, span)
        state = _corrected(state, *(Vec3(zero, zero, part) for part in parts))
        return replace(state, since_height=jnp.where(new, 0.0, state.since_height))

    def _corrections(
        self, gains: tuple[Array, Array], error: Array, slip: Array, span: Array
    ) -> tuple[Array, Array, Array]:
        """Return the corrections (n,) of position [m], velocity [m/s] and bias [m/s^2] along one axis (eq. C17).

        Args:
            gains: of the position and of the velocity [1/s].
            error, slip: measured minus estimated position [m] and velocity [m/s] (n,), 0 if not measured.
            span: time since the last correction (n,) [s], 0 if there is no new reading.
        """
        position, velocity = gains
        return (
            position * error * span,
            (velocity * slip + self.velocity_by_position * position * error) * span,
            -self.bias_gain * (slip + self.bias_by_position * error) * span,
        )


def _estimate(state: FilterState) -> Estimate:
    """Return position, velocity and attitude (n,) of the filter's state as an estimate."""
    return Estimate(state.position_ned, state.velocity_ned, state.attitude, state.position_low_ned)


def _corrected(state: FilterState, moved: Vec3, gained: Vec3, learned: Vec3) -> FilterState:
    """Return the state with corrections added to position [m], velocity [m/s] and accelerometer bias [m/s^2], NED."""
    position, low = added(state.position_ned, state.position_low_ned + moved)
    return replace(
        state,
        position_ned=position,
        position_low_ned=low,
        velocity_ned=state.velocity_ned + gained,
        bias_ned=state.bias_ned + learned,
    )
