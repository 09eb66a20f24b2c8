"""State of the error-state Kalman filter, and its correction by small errors.

See docs/explanation/models/estimators.md, F1.

Errors of the attitude are small rotations in NED (Sola, "Quaternion kinematics for the error-state Kalman filter",
2017, section 7).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from qrsim.control.covariance import Covariance, Moves, forgotten, variances, widened
from qrsim.core.pairs import added
from qrsim.core.quaternions import Quaternion
from qrsim.core.symmetric import Term
from qrsim.core.tree import quantity, record, replace
from qrsim.core.vectors import Rotation, Vec3

# Errors by their numbers: position, velocity, attitude (NED), then biases (body axes); others follow (Places).
PLACE, SPEED, TURN, GYROSCOPE, ACCELEROMETER, SIZE = 0, 3, 6, 9, 12, 15
# A specific force turned: for each axis the rotations that change it, with the sign and the axis of what they add.
_SWUNG: tuple[dict[int, tuple[int, int]], ...] = (
    {1: (1, 2), 2: (-1, 1)},
    {0: (-1, 2), 2: (1, 0)},
    {0: (1, 1), 1: (-1, 0)},
)
# Std of each angle [rad] after fixes were rejected for too long.
LOST_TURN_STD = 0.2


@record
class Innovations:
    """Innovations of each kind of reading (n,): measured minus predicted, divided by the std of that difference."""

    position_ned: Array = quantity(unit="1", doc="innovation of the last fix: largest axis, divided by its std")
    velocity_ned: Array = quantity(unit="1", doc="innovation of the last velocity: largest axis, divided by its std")
    height: Array = quantity(unit="1", doc="innovation of the last height, divided by its std")
    yaw: Array = quantity(unit="1", doc="innovation of the last heading, divided by its std")
    field: Array | None = quantity(
        default=None,
        unit="1",
        doc="innovation of the last magnetic field: largest axis, divided by its std; None without its states",
    )
    airspeed: Array | None = quantity(
        default=None, unit="1", doc="innovation of the last airspeed, divided by its std; None without its states"
    )


@record
class Past:
    """Estimate at an earlier tick (n,), with all later corrections; late fixes are compared with it."""

    position_ned: Vec3 = quantity(unit="m", doc="position")
    position_low_ned: Vec3 = quantity(unit="m", doc="remainder of it beyond single precision")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity over ground")


@record
class Inner:
    """States other than position, velocity and attitude, (n,), or the std of each."""

    gyroscope_bias: Vec3 = quantity(unit="rad/s", doc="error of the body rates")
    accelerometer_bias: Vec3 = quantity(unit="m/s^2", doc="error of the specific force, body axes")
    earth_field_ned: Vec3 | None = quantity(default=None, unit="uT", doc="magnetic field of the Earth")
    field_bias: Vec3 | None = quantity(default=None, unit="uT", doc="error of the magnetic field, body axes")
    wind_north: Array | None = quantity(default=None, unit="m/s", doc="wind towards north")
    wind_east: Array | None = quantity(default=None, unit="m/s", doc="wind towards east")
    height_bias: Array | None = quantity(default=None, unit="m", doc="error of the barometer's height, positive up")


@record
class KalmanState:
    """Memory of the filter, (n,) but for the covariance."""

    position_ned: Vec3 = quantity(unit="m", doc="estimated position")
    position_low_ned: Vec3 = quantity(unit="m", doc="remainder of it beyond single precision")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="estimated velocity over ground")
    attitude: Quaternion = quantity(doc="estimated attitude")
    inner: Inner = quantity(doc="other estimated states")
    rates_body: Vec3 = quantity(unit="rad/s", doc="body rates as last measured")
    force_ned: Vec3 = quantity(unit="m/s^2", doc="specific force of the last tick")
    covariance: Covariance = quantity(
        doc="covariance of position, velocity, rotation in NED, both biases, then field and its bias, "
        "wind and bias of the height: rows of half a matrix, see covariance.py, 15 to 24 errors"
    )
    lean: Vec3 = quantity(unit="1", doc="downward direction in body axes, averaged over LEAN_S")
    since_fix: Array = quantity(unit="s", doc="time since the last accepted fix")
    innovations: Innovations = quantity(doc="innovations of the last readings")
    past: tuple[Past, ...] = quantity(default=(), doc="the ticks that fixes are late by, oldest first")
    slow: Vec3 | None = quantity(
        default=None,
        unit="m^2",
        doc="variance of the slow errors of what measures the position, which the covariance "
        "does not contain; None: they have none",
    )

    @property
    def places(self) -> Places:
        """Indices in the covariance of the error states that only some filters have."""
        return Places.of(self.inner)

    @property
    def rotation(self) -> Rotation:
        """Direction cosines of the estimated attitude: the body axes as unit vectors in NED."""
        return self.attitude.rotation()


class Places(NamedTuple):
    """Numbers of the errors that only some filters have, None where it has them not, and how many there are."""

    field: int | None
    field_bias: int | None
    wind: int | None
    height: int | None
    size: int

    @staticmethod
    def of(inner: Inner) -> Places:
        """Return the covariance indices of the optional error states that ``inner`` has."""
        none = inner.earth_field_ned is None
        last = SIZE if none else SIZE + 6
        wind, height = inner.wind_north is not None, inner.height_bias is not None
        return Places(
            None if none else SIZE,
            None if none else SIZE + 3,
            last if wind else None,
            last + 2 if height else None,
            last + 3 if wind or height else last,
        )


def moves(felt: Vec3, turned: Rotation, dt: float) -> Moves:
    """Return the off-diagonal terms of one tick's transition matrix F, for the specific force ``felt`` NED (eq. F1)."""
    place, speed, turn, gyroscope, accelerometer = PLACE, SPEED, TURN, GYROSCOPE, ACCELEROMETER
    factors = [*felt.axes, *(cosine for axis in body_axes(turned) for cosine in axis.axes)]
    terms = [Term(place + i, speed + i, dt) for i in range(3)]
    for i, row in enumerate(_SWUNG):
        terms += [Term(speed + i, turn + k, dt * sign, axis) for k, (sign, axis) in row.items()]
        biased = [3 + 3 * k + i for k in range(3)]
        terms += [Term(speed + i, accelerometer + k, -dt, number) for k, number in enumerate(biased)]
        terms += [Term(turn + i, gyroscope + k, -dt, number) for k, number in enumerate(biased)]
    return Moves(terms, factors)


def swung(force: Vec3) -> tuple[dict[int, Array], ...]:
    """Return the derivatives of a specific force (n,) NED by small rotations, {NED axis: (n,)} for each of its axes."""
    return tuple({k: sign * force.axes[axis] for k, (sign, axis) in row.items()} for row in _SWUNG)


def body_axes(turned: Rotation) -> tuple[Vec3, Vec3, Vec3]:
    """Return the body's forward, right and down axes as unit vectors in NED, by its rotation."""
    return turned.forward, turned.right, turned.down


def of_angles(turned: Rotation) -> tuple[dict[int, Array], dict[int, Array], dict[int, Array]]:
    """Return derivatives of roll, pitch, yaw by small NED rotations, {error index: (n,)}; bounded at 90 deg pitch."""
    ahead = turned.forward
    square = jnp.maximum(ahead.x * ahead.x + ahead.y * ahead.y, 1e-4)
    level = jnp.sqrt(square)
    cosine, sine = ahead.x / level, ahead.y / level
    return (
        {TURN: cosine / level, TURN + 1: sine / level},
        {TURN: -sine, TURN + 1: cosine},
        {TURN: -ahead.z * ahead.x / square, TURN + 1: -ahead.z * ahead.y / square, TURN + 2: jnp.ones_like(square)},
    )


def with_turn(covariance: Covariance, after: Sequence[Array]) -> Covariance:
    """Return the covariance with the variances of the attitude errors replaced by ``after``, three of (n,) [rad^2]."""
    before = variances(covariance)[TURN:GYROSCOPE]
    return widened(covariance, {TURN + i: new - old for i, (new, old) in enumerate(zip(after, before, strict=True))})


def small(half: Vec3) -> Quaternion:
    """Return the quaternion of a small rotation from half its rotation vector (n,) [rad]."""
    square = half.dot(half)
    scale = 1.0 - square / 6.0
    return Quaternion(1.0 - 0.5 * square, half.x * scale, half.y * scale, half.z * scale)


def lost(covariance: Covariance, variances: Sequence[Array], where: Array) -> Covariance:
    """Return the covariance with position, velocity, attitude reset (large, uncorrelated) where ``where`` (n,) is True.

    So the next fix is accepted whatever its value. Fixes were rejected for long, perhaps because of a wrong tilt, and a
    filter that trusted its tilt would diverge again at once.
    """
    wide: Mapping[int, Array] = {
        **{PLACE + axis: 1e4 * variance for axis, variance in enumerate(variances)},
        **{SPEED + axis: jnp.full_like(variance, 100.0) for axis, variance in enumerate(variances)},
        **{TURN + axis: jnp.full_like(variances[0], LOST_TURN_STD**2) for axis in range(3)},
    }
    return forgotten(covariance, wide, where)


def injected(state: KalmanState, errors: Array, dt: float) -> KalmanState:
    """Return the filter's state, its stored past included, corrected by estimated errors (m, n)."""
    place, speed, turn = (_three(errors, first) for first in (PLACE, SPEED, TURN))
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
        attitude=(small(0.5 * turn) * state.attitude).normalised(),
        inner=_inner(state.inner, errors),
    )


def _inner(inner: Inner, errors: Array) -> Inner:
    """Return biases, magnetic field, wind and height error corrected by the estimated errors (m, n)."""
    places = Places.of(inner)
    inner = replace(
        inner,
        gyroscope_bias=inner.gyroscope_bias + _three(errors, GYROSCOPE),
        accelerometer_bias=inner.accelerometer_bias + _three(errors, ACCELEROMETER),
    )
    if places.field is not None and places.field_bias is not None:
        assert inner.earth_field_ned is not None
        assert inner.field_bias is not None
        inner = replace(
            inner,
            earth_field_ned=inner.earth_field_ned + _three(errors, places.field),
            field_bias=inner.field_bias + _three(errors, places.field_bias),
        )
    if places.wind is not None:
        assert inner.wind_north is not None
        assert inner.wind_east is not None
        inner = replace(
            inner,
            wind_north=inner.wind_north + errors[places.wind],
            wind_east=inner.wind_east + errors[places.wind + 1],
        )
    if places.height is not None:
        assert inner.height_bias is not None
        inner = replace(inner, height_bias=inner.height_bias + errors[places.height])
    return inner


def inner_std(state: KalmanState, unseen: Sequence[Array | float] = (0.0,) * (SIZE - GYROSCOPE)) -> Inner:
    """Return the standard deviation of each quantity in ``state.inner``; leading axes, such as ticks, are allowed.

    Args:
        state: of the filter.
        unseen: variances of the biases of gyroscope and accelerometer that the covariance does not contain.
    """
    places = state.places
    # NumPy stays NumPy: a log calls this for each part of a flight.
    more = dict(enumerate(unseen, GYROSCOPE))
    own = [(variance + more.get(k, 0.0)) ** 0.5 for k, variance in enumerate(variances(state.covariance))]

    def three(first: int | None) -> Vec3 | None:
        """Return the stds of the errors with indices ``first`` to ``first`` + 2 as a vector; None for None."""
        return None if first is None else Vec3(*own[first : first + 3])

    return Inner(
        Vec3(*own[GYROSCOPE:ACCELEROMETER]),
        Vec3(*own[ACCELEROMETER:SIZE]),
        three(places.field),
        three(places.field_bias),
        None if places.wind is None else own[places.wind],
        None if places.wind is None else own[places.wind + 1],
        None if places.height is None else own[places.height],
    )


def _three(errors: Array, first: int) -> Vec3:
    """Return the errors with indices ``first`` to ``first`` + 2 as a vector."""
    return Vec3(errors[first], errors[first + 1], errors[first + 2])
