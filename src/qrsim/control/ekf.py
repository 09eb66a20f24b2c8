"""An error-state extended Kalman filter on inertial, GNSS, height, heading, magnetic and air speed readings.

Equations F1 to F5 of docs/estimators.md. Gates, late measurements and resets follow what autopilots do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
from jax import Array, lax

from qrsim.control.consistency import Consistency, Truth, of_blocks, turned
from qrsim.control.contracts import Estimator
from qrsim.control.covariance import (
    BLOCK,
    Covariance,
    corrected,
    expected,
    independent,
    matrix,
    propagated,
    variance_of,
    variances,
)
from qrsim.control.kalman_readings import Measured, airspeeds, compass, fields, headings, heights, places, velocities
from qrsim.control.kalman_state import (
    SPEED,
    TURN,
    Inner,
    Innovations,
    KalmanState,
    Past,
    injected,
    inner_std,
    lost,
    moves,
    of_angles,
    small,
)
from qrsim.control.reading_fields import AIRSPEED, FIELD, field_of, known, source_of
from qrsim.control.setpoints import Estimate
from qrsim.core.fastmath import arctan2
from qrsim.core.pairs import added
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import derived, parameter, record, replace, setting
from qrsim.core.vectors import Euler, Vec3

# Covariance, mean errors, time since a fix that was believed, and innovations.
Corrected = tuple[Covariance, Array, Array, Innovations]


@record
class ErrorStateKalmanFilter(Estimator):
    """Position, velocity, attitude and the biases of gyroscope and accelerometer, with their covariance.

    With a magnetometer the Earth's field and its bias are estimated too, with an airspeed sensor the horizontal wind.
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
    magnetometer: Literal["field", "heading"] = setting(
        default="field", doc="what a magnetic field is taken for: three axes, with states of their own, or a heading"
    )
    earth_field_std: Array = parameter(
        default=0.5, unit="uT", doc="of the Earth's field at the start, per axis", minimum=0.0
    )
    field_bias_std: Array = parameter(default=2.0, unit="uT", doc="of its bias at the start, per axis", minimum=0.0)
    field_std: Array = parameter(default=0.5, unit="uT", doc="of a magnetic field, per axis", above=0.0)
    field_walk: Array = parameter(
        default=0.005, unit="uT/sqrt(s)", doc="random walk of the Earth's field as flown through, and of the bias",
        minimum=0.0,
    )  # fmt: skip
    airspeed_std: Array = parameter(default=1.0, unit="m/s", doc="of an airspeed", above=0.0)
    airspeed_least: Array = parameter(default=5.0, unit="m/s", doc="airspeed below which none is believed", minimum=0.0)
    wind_std: Array = parameter(default=6.0, unit="m/s", doc="of the wind at the start, per axis", minimum=0.0)
    wind_walk: Array = parameter(default=0.5, unit="m/s/sqrt(s)", doc="random walk of the wind, gusts included",
                                 minimum=0.0)  # fmt: skip
    height_bias: bool = setting(
        default=False, doc="whether the barometer's error is estimated, so that fixes hold the height for long"
    )
    height_bias_std: Array = parameter(default=0.5, unit="m", doc="of it at the start", minimum=0.0)
    height_bias_walk: Array = parameter(default=0.02, unit="m/sqrt(s)", doc="its random walk", minimum=0.0)
    earth_field_ned: Vec3 | None = derived(default=None, doc="the Earth's field at the site [uT]; None: not known")
    ages: tuple[tuple[str, int], ...] = derived(default=(), doc="sensors by name, and ticks their readings are late by",
                                                static=True)  # fmt: skip

    # Barometer, heading, magnetometer and airspeed are of use, and not needed.
    reads: ClassVar[tuple[str, ...]] = ("gnss_receiver", "accelerometer", "gyroscope")

    def fitted(self, ages: Mapping[str, int], earth_field_ned: Vec3 | None = None) -> ErrorStateKalmanFilter:
        """Return the filter that knows how late the readings of each sensor are [ticks], and the Earth's field [uT]."""
        return replace(self, ages=tuple(sorted(ages.items())), earth_field_ned=earth_field_ned)

    def _late(self, readings: Mapping[str, Any]) -> int:
        """Return how late a fix is [ticks]."""
        return dict(self.ages).get(source_of(readings, "position_ned"), 0)

    def init(self, readings: Mapping[str, Any], start: Estimate) -> tuple[KalmanState, Estimate]:
        """Return state and estimate (n,) at the first readings; what they do not say is that of the start."""
        fix, velocity = field_of(readings, "position_ned"), field_of(readings, "velocity_ned")
        height, attitude = field_of(readings, "height"), field_of(readings, "attitude")
        rates = field_of(readings, "rates_body")
        position = start.position_ned if fix is None else known(fix, start.position_ned)
        # With a bias the first height is that of the fix, so that the two are wrong independently.
        by_height = height is not None and not self.height_bias
        if height is not None and by_height:
            position = replace(position, z=known(-height, start.position_ned.z))
        speed = start.velocity_ned if velocity is None else known(velocity, start.velocity_ned)
        yaw = start.attitude.yaw if attitude is None else known(attitude.yaw, start.attitude.yaw)
        zero = jnp.zeros_like(position.x)
        none = Vec3(zero, zero, zero)
        begun = Quaternion.of(replace(start.attitude, yaw=yaw))
        inner = self._first_inner(readings, begun, none)
        tilt, yaw_variance = self._as(zero, self.tilt_std), self._as(zero, self.yaw_std)
        covariance = independent(
            [
                *self._variances(readings, "position_ned", zero, by_height),
                *self._variances(readings, "velocity_ned", zero),
                *(tilt, tilt, yaw_variance),
                *(self._as(zero, std) for std in self._inner(inner, self._first_stds)),
            ]
        )
        state = KalmanState(
            position, none, speed, begun, inner, none if rates is None else known(rates, none),
            Vec3(zero, zero, zero - self.gravity), covariance, zero,
            Innovations(
                zero, zero, zero, zero, None if inner.earth_field_ned is None else zero,
                None if inner.wind_north is None else zero,
            ),
            (Past(position, none, speed),) * self._late(readings),
        )  # fmt: skip
        return state, _estimate(state)

    def _first_inner(self, readings: Mapping[str, Any], turned: Quaternion, none: Vec3) -> Inner:
        """Return what is estimated beside the motion at the start: its structure says what the filter has."""
        field, zero = field_of(readings, FIELD), none.x
        inner = Inner(none, none)
        if field is not None and self.magnetometer == "field":
            earth = self._earth_field(known(field, none), turned)
            inner = replace(inner, earth_field_ned=earth, field_bias=none)
        if field_of(readings, AIRSPEED) is not None:
            inner = replace(inner, wind_north=zero, wind_east=zero)
        if self.height_bias and field_of(readings, "height") is not None:
            inner = replace(inner, height_bias=zero)
        return inner

    def _earth_field(self, field: Vec3, turned: Quaternion) -> Vec3:
        """Return the Earth's field (n,) as it is given, else as it is read where nothing is wrong."""
        if self.earth_field_ned is None:
            return turned.rotation().to_ned(field)
        return self.earth_field_ned.map(lambda axis: jnp.zeros_like(field.x) + axis)

    @property
    def _declination(self) -> Array:
        """Where the Earth's field says north to be; north where nobody says what it is."""
        if self.earth_field_ned is None:
            return jnp.zeros_like(self.yaw_std)
        return arctan2(self.earth_field_ned.y, self.earth_field_ned.x)

    @property
    def _first_stds(self) -> tuple[Array, ...]:
        return (
            self.gyroscope_bias_std, self.accelerometer_bias_std, self.earth_field_std, self.field_bias_std,
            self.wind_std, self.height_bias_std,
        )  # fmt: skip

    @property
    def _walks(self) -> tuple[Array, ...]:
        return (
            self.gyroscope_walk, self.accelerometer_walk, self.field_walk, self.field_walk, self.wind_walk,
            self.height_bias_walk,
        )  # fmt: skip

    def _inner(self, inner: Inner, stds: tuple[Array, ...]) -> list[Array]:
        """Return the std of each error that the filter has beside those of the motion: whole blocks, 0 for none."""
        *first, wind, height = stds
        own = first[:2] if inner.earth_field_ned is None else first
        found = [std for std in own for _ in range(3)]
        if inner.wind_north is not None or inner.height_bias is not None:
            known = (inner.wind_north, inner.wind_east, inner.height_bias)
            last = zip(known, (wind, wind, height), strict=True)
            found += [jnp.zeros_like(std) if part is None else std for part, std in last]
        return found

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
        own = [jnp.sqrt(variance) for variance in variances(state.covariance)[:TURN]]
        rows = of_angles(state.rotation)
        angles = [jnp.sqrt(jnp.maximum(variance_of(state.covariance, row)[1], 0.0)) for row in rows]
        return Estimate(Vec3(*own[:SPEED]), Vec3(*own[SPEED:]), Euler(*angles))

    def inner(self, state: KalmanState) -> tuple[Inner, Inner]:
        """Return what it estimates beside the motion, and the std of it."""
        return state.inner, inner_std(state)

    def consistency(self, state: KalmanState, truth: Truth) -> Consistency:
        """Return how large its errors are beside what it states (n,); of magnetic field and wind nothing is said."""
        biases = (truth.gyroscope_bias, truth.accelerometer_bias)
        known_biases = None not in biases
        place = truth.position_ned - state.position_ned - state.position_low_ned
        if truth.position_low_ned is not None:
            place = place + truth.position_low_ned
        parts = [place, truth.velocity_ned - state.velocity_ned, turned(truth.attitude, state.attitude)]
        if known_biases:
            own = (state.inner.gyroscope_bias, state.inner.accelerometer_bias)
            parts += [bias - mean for bias, mean in zip(biases, own, strict=True) if bias is not None]
        return of_blocks(matrix(state.covariance), [axis for part in parts for axis in part.axes], known_biases)

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
        half = (0.5 * (rates + state.rates_body) - state.inner.gyroscope_bias) * (0.5 * dt)
        before = state.rotation
        attitude = (state.attitude * small(half)).normalised()
        after = attitude.rotation()
        felt = Vec3(zero, zero, zero - self.gravity)
        if force is not None:
            body = force - state.inner.accelerometer_bias
            found = 0.5 * (before.to_ned(body) + after.to_ned(body))
            # Without a reading the velocity is held.
            seen = jnp.isfinite(found.x) & jnp.isfinite(found.y) & jnp.isfinite(found.z)
            felt = Vec3(*(jnp.where(seen, axis, still) for axis, still in zip(found.axes, felt.axes, strict=True)))
        change = replace(felt, z=felt.z + self.gravity) * dt
        position, low = added(state.position_ned, state.position_low_ned + (state.velocity_ned + 0.5 * change) * dt)
        covariance = propagated(state.covariance, moves(felt, after, dt), self._noise(state.inner, dt))
        return replace(
            state, position_ned=position, position_low_ned=low, velocity_ned=state.velocity_ned + change,
            attitude=attitude, rates_body=rates, force_ned=felt, since_fix=state.since_fix + dt, covariance=covariance,
        )  # fmt: skip

    def _noise(self, inner: Inner, dt: float) -> list[Array]:
        """Return the variance that a tick adds to each error (F1)."""
        of_motion = (0.0 * self.accelerometer_noise, self.accelerometer_noise, self.gyroscope_noise)
        stds = [*(std for std in of_motion for _ in range(3)), *self._inner(inner, self._walks)]
        return [std * std * dt for std in stds]

    def _measured(
        self, state: KalmanState, readings: Mapping[str, Any], fresh: Mapping[str, Array], dt: float
    ) -> KalmanState:
        """Return the state corrected by what is new (F2)."""
        none = jnp.zeros((state.places.size // BLOCK, BLOCK, *state.since_fix.shape), state.since_fix.dtype)
        carry: Corrected = (state.covariance, none, state.since_fix, state.innovations)
        for what, scalars, new, due in self._groups(state, readings, fresh, dt):
            believe = partial(self._believed, what, scalars, new)
            # Between two readings of a sensor nothing is computed; who hears at times of their own are all looked at.
            carry = lax.cond(due, believe, _unchanged, carry) if due.ndim == 0 else believe(carry)
        covariance, errors, since_fix, innovations = carry
        state = replace(state, covariance=covariance, since_fix=since_fix, innovations=innovations)
        return injected(state, errors.reshape(-1, *state.since_fix.shape), dt)

    def _believed(self, what: str, scalars: list[Measured], new: Array, carry: Corrected) -> Corrected:
        """Return covariance, errors, time since a fix, and innovations, after the scalars of one kind of reading."""
        covariance, errors, since_fix, innovations = carry
        for scalar in scalars:
            new = new & jnp.isfinite(scalar.innovation)
        worst = self._worst(covariance, errors, scalars)
        believed = new & (worst <= self.gate * self.gate)
        if what == "position_ned":
            again = new & ~believed & (since_fix > self.reset_after)
            covariance, believed = lost(covariance, [s.variance for s in scalars], again), believed | again
            since_fix = jnp.where(believed, 0.0, since_fix)
        for scalar in scalars:
            covariance, errors = corrected(
                covariance, errors, scalar.sensitivity, scalar.innovation, scalar.variance, believed
            )
        shown = jnp.where(new, jnp.sqrt(worst), getattr(innovations, what))
        return covariance, errors, since_fix, replace(innovations, **{what: shown})

    def _worst(self, covariance: Covariance, errors: Array, scalars: list[Measured]) -> Array:
        """Return the largest square of a kind's innovations (n,), each over its variance."""
        worst = jnp.zeros_like(scalars[0].innovation)
        for scalar in scalars:
            left = scalar.innovation - expected(errors, scalar.sensitivity)
            spread = variance_of(covariance, scalar.sensitivity)[1] + scalar.variance
            worst = jnp.maximum(worst, left * left / spread)
        return worst

    def _groups(
        self, state: KalmanState, readings: Mapping[str, Any], fresh: Mapping[str, Array], dt: float
    ) -> Iterator[tuple[str, list[Measured], Array, Array]]:
        """Yield what is measured: the kind, its scalars, whether it is new (n,), and whether at all, () or (n,)."""
        one = jnp.ones_like(state.since_fix)

        def new(field: str) -> tuple[Array, Array]:
            due = fresh[source_of(readings, field)]
            return due & (one > 0.0), due

        yield from self._by_fix(state, readings, new, dt)
        height, field, attitude = (field_of(readings, name) for name in ("height", FIELD, "attitude"))
        if height is not None:
            yield "height", heights(state, height, self._as(one, self.height_std)), *new("height")
        if field is not None and state.places.field is not None:
            yield "field", fields(state, field, self._as(one, self.field_std)), *new(FIELD)
        elif field is not None:
            yield "yaw", compass(state, field, self._declination, self._as(one, self.yaw_std)), *new(FIELD)
        elif attitude is not None:
            yield "yaw", headings(state, attitude, self._as(one, self.yaw_std)), *new("attitude")
        airspeed = field_of(readings, AIRSPEED)
        if airspeed is not None:
            heard, due = new(AIRSPEED)
            fast = heard & (airspeed >= self.airspeed_least)
            yield "airspeed", airspeeds(state, airspeed, self._as(one, self.airspeed_std)), fast, due

    def _by_fix(
        self, state: KalmanState, readings: Mapping[str, Any], new: Callable[[str], tuple[Array, Array]], dt: float
    ) -> Iterator[tuple[str, list[Measured], Array, Array]]:
        """Yield what a fix measures: place and velocity of as many ticks ago as it is late (F2)."""
        one = jnp.ones_like(state.since_fix)
        late = dt * len(state.past)
        fix, velocity = field_of(readings, "position_ned"), field_of(readings, "velocity_ned")
        if fix is not None:
            # A barometer without a bias has the height alone.
            axes = "xy" if field_of(readings, "height") is not None and not self.height_bias else "xyz"
            variances = self._variances(readings, "position_ned", one)
            yield "position_ned", places(state, fix, variances, axes, late), *new("position_ned")
        if velocity is not None:
            variances = self._variances(readings, "velocity_ned", one)
            yield "velocity_ned", velocities(state, velocity, variances, late), *new("velocity_ned")


def _unchanged(carry: Corrected) -> Corrected:
    return carry


def _estimate(state: KalmanState) -> Estimate:
    return Estimate(state.position_ned, state.velocity_ned, state.attitude.euler(), state.position_low_ned)
