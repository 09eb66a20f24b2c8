"""An error-state extended Kalman filter on inertial, GNSS, height and heading readings (docs/estimators.md, F1 and F2).

Errors of the attitude are small rotations in NED (Sola, "Quaternion kinematics for the error-state Kalman filter",
2017, section 7); gates, late measurements and resets follow what autopilots do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jax import Array

from qrsim.control.contracts import Estimator
from qrsim.control.covariance import corrected, diagonal, expected, forgotten, propagated, variance_of
from qrsim.control.reading_fields import field_of, known, source_of
from qrsim.control.setpoints import Estimate
from qrsim.core.fastmath import wrap_angle
from qrsim.core.pairs import added
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import derived, parameter, quantity, record, replace
from qrsim.core.vectors import Euler, Rotation, Vec3

# Errors by their numbers: position, velocity, attitude (NED), then biases (body axes).
PLACE, SPEED, TURN, GYROSCOPE, ACCELEROMETER, SIZE = 0, 3, 6, 9, 12, 15


@record
class Innovations:
    """What each kind of reading said beside what was expected, (n,), in units of the std expected of it."""

    position_ned: Array = quantity(unit="1", doc="of the last fix: largest axis, over its std")
    velocity_ned: Array = quantity(unit="1", doc="of the last velocity: largest axis, over its std")
    height: Array = quantity(unit="1", doc="of the last height, over its std")
    yaw: Array = quantity(unit="1", doc="of the last heading, over its std")


@record
class Past:
    """Where the vehicles (n,) were, as far as is known now."""

    position_ned: Vec3 = quantity(unit="m", doc="position")
    position_low_ned: Vec3 = quantity(unit="m", doc="what single precision leaves out of it")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity over ground")


@record
class KalmanState:
    """Memory of the filter, (n,) but for the covariance."""

    position_ned: Vec3 = quantity(unit="m", doc="estimated position")
    position_low_ned: Vec3 = quantity(unit="m", doc="what single precision leaves out of it")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="estimated velocity over ground")
    attitude: Quaternion = quantity(doc="estimated attitude")
    gyroscope_bias: Vec3 = quantity(unit="rad/s", doc="estimated error of the body rates")
    accelerometer_bias: Vec3 = quantity(unit="m/s^2", doc="estimated error of the specific force, body axes")
    rates_body: Vec3 = quantity(unit="rad/s", doc="body rates as last measured")
    force_ned: Vec3 = quantity(unit="m/s^2", doc="specific force of the last tick")
    covariance: Array = quantity(doc="of position, velocity, rotation in NED and both biases, (15, 15, n)")
    since_fix: Array = quantity(unit="s", doc="time since the last fix that was believed")
    innovations: Innovations = quantity(doc="of the last readings")
    past: tuple[Past, ...] = quantity(default=(), doc="the ticks that fixes are late by, oldest first")


class _Measured(NamedTuple):
    """A scalar measurement: what it was expected to be wrong by, and how it depends on the errors."""

    innovation: Array
    variance: Array
    sensitivity: dict[int, Array]


@record
class ErrorStateKalmanFilter(Estimator):
    """Position, velocity, attitude and the biases of gyroscope and accelerometer, with their covariance.

    Readings that are too far from what is expected are not believed (gates); fixes that are not for ``reset_after``
    are, and the filter begins there again. Noise that is correlated in time, as that of GNSS is, is taken for white.
    """

    gyroscope_noise: Array = parameter(default=1e-3, unit="rad/s/sqrt(Hz)", doc="density of white noise", minimum=0.0)
    accelerometer_noise: Array = parameter(
        default=0.02, unit="m/s^2/sqrt(Hz)", doc="density of white noise, vibration included", minimum=0.0
    )
    gyroscope_walk: Array = parameter(default=2e-5, unit="rad/s/sqrt(s)", doc="random walk of its bias", minimum=0.0)
    accelerometer_walk: Array = parameter(
        default=3e-4, unit="m/s^2/sqrt(s)", doc="random walk of its bias", minimum=0.0
    )
    gyroscope_bias_std: Array = parameter(default=0.01, unit="rad/s", doc="of its bias at the start", minimum=0.0)
    accelerometer_bias_std: Array = parameter(default=0.1, unit="m/s^2", doc="of its bias at the start", minimum=0.0)
    position_std: Array = parameter(
        default=1.5, unit="m", doc="of a fix, per horizontal axis, where it states no accuracy", above=0.0
    )
    vertical_std: Array = parameter(default=2.5, unit="m", doc="the same, down", above=0.0)
    velocity_std: Array = parameter(
        default=0.2, unit="m/s", doc="of a fix's velocity, per axis, where it states no accuracy", above=0.0
    )
    height_std: Array = parameter(default=0.3, unit="m", doc="of a height by the barometer", above=0.0)
    yaw_std: Array = parameter(default=0.05, unit="rad", doc="of a heading", above=0.0)
    tilt_std: Array = parameter(default=0.03, unit="rad", doc="of roll and pitch at the start", minimum=0.0)
    gate: Array = parameter(default=5.0, unit="1", doc="stds from what is expected beyond which nothing is believed",
                            above=0.0)  # fmt: skip
    reset_after: Array = parameter(
        default=7.0, unit="s", doc="time without a believed fix after which the next is", above=0.0
    )
    gravity: Array = parameter(default=9.81, unit="m/s^2", doc="acceleration of free fall", minimum=0.0)
    ages: tuple[tuple[str, int], ...] = derived(default=(), doc="sensors by name, and ticks their readings are late by",
                                                static=True)  # fmt: skip

    # A barometer is of use, and not needed.
    reads: ClassVar[tuple[str, ...]] = ("gnss_receiver", "attitude_estimator", "accelerometer", "gyroscope")

    def fitted(self, ages: Mapping[str, int]) -> ErrorStateKalmanFilter:
        """Return the filter that knows how late the readings of each sensor are [ticks]."""
        return replace(self, ages=tuple(sorted(ages.items())))

    def _late(self, readings: Mapping[str, Any]) -> int:
        """Return how late a fix is [ticks]."""
        return dict(self.ages).get(source_of(readings, "position_ned"), 0)

    def init(self, readings: Mapping[str, Any], start: Estimate) -> tuple[KalmanState, Estimate]:
        """Return state and estimate (n,) at the first readings; what they do not say is that of the start."""
        fix, velocity = field_of(readings, "position_ned"), field_of(readings, "velocity_ned")
        height, attitude = field_of(readings, "height"), field_of(readings, "attitude")
        rates = field_of(readings, "rates_body")
        position = start.position_ned if fix is None else known(fix, start.position_ned)
        if height is not None:
            position = replace(position, z=known(-height, start.position_ned.z))
        speed = start.velocity_ned if velocity is None else known(velocity, start.velocity_ned)
        yaw = start.attitude.yaw if attitude is None else known(attitude.yaw, start.attitude.yaw)
        zero = jnp.zeros_like(position.x)
        none = Vec3(zero, zero, zero)
        covariance = diagonal(
            [
                *self._variances(readings, "position_ned", zero, height is not None),
                *self._variances(readings, "velocity_ned", zero),
                *(self._as(zero, self.tilt_std),) * 2,
                self._as(zero, self.yaw_std),
                *(self._as(zero, self.gyroscope_bias_std),) * 3,
                *(self._as(zero, self.accelerometer_bias_std),) * 3,
            ]
        )
        state = KalmanState(
            position, none, speed, Quaternion.of(replace(start.attitude, yaw=yaw)), none, none,
            none if rates is None else known(rates, none), Vec3(zero, zero, zero - self.gravity),
            covariance, zero, Innovations(zero, zero, zero, zero),
            (Past(position, none, speed),) * self._late(readings),
        )  # fmt: skip
        return state, _estimate(state)

    def step(
        self, state: KalmanState, readings: Mapping[str, Any], fresh: Mapping[str, Array], dt: float
    ) -> tuple[KalmanState, Estimate]:
        """Advance one tick of dt [s] to the readings (n,) of now, and return the estimate (n,)."""
        past = (*state.past, Past(state.position_ned, state.position_low_ned, state.velocity_ned))
        state = replace(self._predicted(state, readings, dt), past=past[1:] if state.past else ())
        state = self._measured(state, readings, fresh, dt)
        return state, _estimate(state)

    def std(self, state: KalmanState) -> Estimate:
        """Return the standard deviations (n,) of its estimate."""
        own = [jnp.sqrt(state.covariance[i, i]) for i in range(TURN)]
        rows = _of_angles(state.attitude.rotation())
        angles = [jnp.sqrt(jnp.maximum(variance_of(state.covariance, row)[1], 0.0)) for row in rows]
        return Estimate(Vec3(*own[:SPEED]), Vec3(*own[SPEED:]), Euler(*angles))

    def innovations(self, state: KalmanState) -> Innovations:
        """Return what the last readings said beside what was expected, in std."""
        return state.innovations

    def _as(self, like: Array, std: Array) -> Array:
        return jnp.zeros_like(like) + std * std

    def _variances(
        self, readings: Mapping[str, Any], what: str, like: Array, by_height: bool = False
    ) -> tuple[Array, Array, Array]:
        """Return the variance of each axis of a fix (n,): by the accuracy that it states, else by the parameters."""
        if what == "velocity_ned":
            stated = field_of(readings, "speed_accuracy")
            level = down = self._as(like, self.velocity_std)
            if stated is not None:
                level = down = known(stated * stated, level)
            return level, level, down
        level = self._as(like, self.position_std)
        down = self._as(like, self.height_std if by_height else self.vertical_std)
        if (stated := field_of(readings, "horizontal_accuracy")) is not None:
            # Of both axes together.
            level = known(0.5 * stated * stated, level)
        if not by_height and (stated := field_of(readings, "vertical_accuracy")) is not None:
            down = known(stated * stated, down)
        return level, level, down

    def _predicted(self, state: KalmanState, readings: Mapping[str, Any], dt: float) -> KalmanState:
        """Return the state a tick later, by body rates and the mean specific force of the tick (F1)."""
        zero = jnp.zeros_like(state.since_fix)
        rates, force = field_of(readings, "rates_body"), field_of(readings, "specific_force")
        rates = state.rates_body if rates is None else known(rates, state.rates_body)
        half = (0.5 * (rates + state.rates_body) - state.gyroscope_bias) * (0.5 * dt)
        before = state.attitude.rotation()
        attitude = (state.attitude * _small(half)).normalised()
        after = attitude.rotation()
        felt = Vec3(zero, zero, zero - self.gravity)
        if force is not None:
            body = force - state.accelerometer_bias
            found = 0.5 * (before.to_ned(body) + after.to_ned(body))
            # Without a reading the velocity is held.
            seen = jnp.isfinite(found.x) & jnp.isfinite(found.y) & jnp.isfinite(found.z)
            felt = Vec3(*(jnp.where(seen, axis, still) for axis, still in zip(found.axes, felt.axes, strict=True)))
        change = replace(felt, z=felt.z + self.gravity) * dt
        position, low = added(state.position_ned, state.position_low_ned + (state.velocity_ned + 0.5 * change) * dt)
        covariance = propagated(state.covariance, _transition(felt, after, dt), self._noise(zero, dt))
        return replace(
            state, position_ned=position, position_low_ned=low, velocity_ned=state.velocity_ned + change,
            attitude=attitude, rates_body=rates, force_ned=felt, since_fix=state.since_fix + dt, covariance=covariance,
        )  # fmt: skip

    def _noise(self, like: Array, dt: float) -> list[Array]:
        none = 0.0 * self.accelerometer_noise
        stds = (none, self.accelerometer_noise, self.gyroscope_noise, self.gyroscope_walk, self.accelerometer_walk)
        return [self._as(like, std) * dt for std in stds for _ in range(3)]

    def _measured(
        self, state: KalmanState, readings: Mapping[str, Any], fresh: Mapping[str, Array], dt: float
    ) -> KalmanState:
        """Return the state corrected by what is new (F2)."""
        covariance, errors = state.covariance, jnp.zeros_like(state.covariance[0])
        for what, scalars, new in self._groups(state, readings, fresh, dt):
            for scalar in scalars:
                new = new & jnp.isfinite(scalar.innovation)
            worst = self._worst(covariance, errors, scalars)
            believed = new & (worst <= self.gate * self.gate)
            if what == "position_ned":
                again = new & ~believed & (state.since_fix > self.reset_after)
                covariance, believed = _lost(covariance, scalars, again), believed | again
                state = replace(state, since_fix=jnp.where(believed, 0.0, state.since_fix))
            for scalar in scalars:
                covariance, errors = corrected(
                    covariance, errors, scalar.sensitivity, scalar.innovation, scalar.variance, believed
                )
            shown = jnp.where(new, jnp.sqrt(worst), getattr(state.innovations, what))
            state = replace(state, innovations=replace(state.innovations, **{what: shown}))
        return _injected(replace(state, covariance=covariance), errors, dt)

    def _worst(self, covariance: Array, errors: Array, scalars: list[_Measured]) -> Array:
        """Return the largest square of a kind's innovations (n,), each over its variance."""
        worst = jnp.zeros_like(scalars[0].innovation)
        for scalar in scalars:
            left = scalar.innovation - expected(errors, scalar.sensitivity)
            spread = variance_of(covariance, scalar.sensitivity)[1] + scalar.variance
            worst = jnp.maximum(worst, left * left / spread)
        return worst

    def _groups(
        self, state: KalmanState, readings: Mapping[str, Any], fresh: Mapping[str, Array], dt: float
    ) -> Iterator[tuple[str, list[_Measured], Array]]:
        """Yield what is measured: the kind, its scalars, and whether it is new (n,)."""
        one = jnp.ones_like(state.since_fix)

        def new(field: str) -> Array:
            return fresh[source_of(readings, field)] & (one > 0.0)

        height, attitude = field_of(readings, "height"), field_of(readings, "attitude")
        yield from self._by_fix(state, readings, new, dt)
        if height is not None:
            miss = -height - state.position_ned.z - state.position_low_ned.z
            yield "height", [_Measured(miss, self._as(one, self.height_std), {PLACE + 2: one})], new("height")
        if attitude is not None:
            miss = wrap_angle(attitude.yaw - state.attitude.euler().yaw)
            turns = _of_angles(state.attitude.rotation())[2]
            yield "yaw", [_Measured(miss, self._as(one, self.yaw_std), turns)], new("attitude")

    def _by_fix(
        self, state: KalmanState, readings: Mapping[str, Any], new: Callable[[str], Array], dt: float
    ) -> Iterator[tuple[str, list[_Measured], Array]]:
        """Yield what a fix measures: place and velocity of as many ticks ago as it is late (F2)."""
        one = jnp.ones_like(state.since_fix)
        late = dt * len(state.past)
        then = state.past[0] if state.past else Past(state.position_ned, state.position_low_ned, state.velocity_ned)
        fix, velocity = field_of(readings, "position_ned"), field_of(readings, "velocity_ned")
        if fix is not None:
            variances = self._variances(readings, "position_ned", one)
            scalars = []
            for i, axis in enumerate("xyz" if field_of(readings, "height") is None else "xy"):
                miss = getattr(fix, axis) - getattr(then.position_ned, axis) - getattr(then.position_low_ned, axis)
                # An error of the velocity now was there then, too.
                back = {SPEED + i: -late * one} if state.past else {}
                scalars.append(_Measured(miss, variances[i], {PLACE + i: one, **back}))
            yield "position_ned", scalars, new("position_ned")
        if velocity is not None:
            variances = self._variances(readings, "velocity_ned", one)
            turns = _swung(state.force_ned)
            body = zip(*(axis.axes for axis in _body_axes(state.attitude.rotation())), strict=True)
            scalars = []
            for i, (axis, cosines) in enumerate(zip("xyz", body, strict=True)):
                back = {TURN + k: -late * factor for k, factor in turns[i].items()} if state.past else {}
                back |= {ACCELEROMETER + k: late * factor for k, factor in enumerate(cosines)} if state.past else {}
                miss = getattr(velocity, axis) - getattr(then.velocity_ned, axis)
                scalars.append(_Measured(miss, variances[i], {SPEED + i: one, **back}))
            yield "velocity_ned", scalars, new("velocity_ned")


def _lost(covariance: Array, scalars: list[_Measured], where: Array) -> Array:
    """Return a covariance that knows nothing of place and speed, where a fix is to be believed whatever it says."""
    wide = {PLACE + axis: 1e4 * scalar.variance for axis, scalar in enumerate(scalars)}
    wide |= {SPEED + axis: jnp.full_like(scalar.variance, 100.0) for axis, scalar in enumerate(scalars)}
    return forgotten(covariance, wide, where)


def _small(half: Vec3) -> Quaternion:
    """Return the rotation by twice a small vector (n,) [rad], to its third order."""
    square = half.dot(half)
    scale = 1.0 - square / 6.0
    return Quaternion(1.0 - 0.5 * square, half.x * scale, half.y * scale, half.z * scale)


def _transition(felt: Vec3, turned: Rotation, dt: float) -> Callable[[Array], Array]:
    """Return what a tick makes of the errors: F X for X (15, k, n) (F1)."""
    none = jnp.zeros_like(felt.x)
    swung = jnp.stack([jnp.stack([dt * row.get(k, none) for k in range(3)]) for row in _swung(felt)])
    rows = zip(*(axis.axes for axis in _body_axes(turned)), strict=True)
    biased = jnp.stack([jnp.stack([-dt * cosine for cosine in row]) for row in rows])

    def moved(x: Array) -> Array:
        place, speed, turn, gyroscope, accelerometer = (x[first : first + 3] for first in range(0, SIZE, 3))
        return jnp.concatenate(
            [
                place + dt * speed,
                speed + _times(swung, turn) + _times(biased, accelerometer),
                turn + _times(biased, gyroscope),
                gyroscope,
                accelerometer,
            ]
        )

    return moved


def _swung(force: Vec3) -> tuple[dict[int, Array], dict[int, Array], dict[int, Array]]:
    """Return how each axis of a specific force changes with a small rotation: it turns with the attitude."""
    x, y, z = force.axes
    return {1: z, 2: -y}, {0: -z, 2: x}, {0: y, 1: -x}


def _body_axes(turned: Rotation) -> tuple[Vec3, Vec3, Vec3]:
    return turned.forward, turned.right, turned.down


def _times(matrix: Array, x: Array) -> Array:
    """Return the product (3, k, n) of matrices (3, 3, n) and (3, k, n)."""
    first, second, third = (matrix[:, k, None] * x[None, k] for k in range(3))
    return first + second + third


def _of_angles(turned: Rotation) -> tuple[dict[int, Array], dict[int, Array], dict[int, Array]]:
    """Return how roll, pitch and yaw change with small rotations in NED; at a pitch of 90 degrees bounded."""
    ahead = turned.forward
    square = jnp.maximum(ahead.x * ahead.x + ahead.y * ahead.y, 1e-4)
    level = jnp.sqrt(square)
    cosine, sine = ahead.x / level, ahead.y / level
    return (
        {TURN: cosine / level, TURN + 1: sine / level},
        {TURN: -sine, TURN + 1: cosine},
        {TURN: -ahead.z * ahead.x / square, TURN + 1: -ahead.z * ahead.y / square, TURN + 2: jnp.ones_like(square)},
    )


def _injected(state: KalmanState, errors: Array, dt: float) -> KalmanState:
    """Return the state with the mean errors (15, n) taken from it."""
    place, speed, turn, gyroscope, accelerometer = (
        Vec3(errors[first], errors[first + 1], errors[first + 2]) for first in range(0, SIZE, 3)
    )
    position, low = added(state.position_ned, state.position_low_ned + place)
    past = []
    for age, then in zip(range(len(state.past), 0, -1), state.past, strict=True):
        moved = place - speed * (age * dt)
        past.append(Past(then.position_ned, then.position_low_ned + moved, then.velocity_ned + speed))
    return replace(
        state,
        past=tuple(past),
        position_ned=position,
        position_low_ned=low,
        velocity_ned=state.velocity_ned + speed,
        attitude=(_small(0.5 * turn) * state.attitude).normalised(),
        gyroscope_bias=state.gyroscope_bias + gyroscope,
        accelerometer_bias=state.accelerometer_bias + accelerometer,
    )


def _estimate(state: KalmanState) -> Estimate:
    return Estimate(state.position_ned, state.velocity_ned, state.attitude.euler(), state.position_low_ned)
