"""An error-state extended Kalman filter on inertial, GNSS, height, heading, magnetic and air speed readings.

Equations F1 to F7 of docs/explanation/models/estimators.md. Gates, late measurements and resets follow what autopilots
do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import jax.numpy as jnp
from jax import Array, lax

from qrsim.control.consistency import Consistency, Truth, of_blocks, turned
from qrsim.control.contracts import Preflight
from qrsim.control.covariance import (
    BLOCK,
    Covariance,
    Measured,
    corrected,
    crossed,
    expected,
    independent,
    matrix,
    propagated,
    variance_of,
    variances,
    widened,
)
from qrsim.control.kalman_parameters import KalmanParameters
from qrsim.control.kalman_readings import airspeeds, compass, fields, headings, heights, places, velocities
from qrsim.control.kalman_start import NORMALS, calibrated, levelled, turned_by
from qrsim.control.kalman_state import (
    GYROSCOPE,
    PLACE,
    SIZE,
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
from qrsim.control.kalman_unseen import Unseen, along, leaned, unseen, with_unseen
from qrsim.control.reading_fields import AIRSPEED, FIELD, field_of, known, source_of
from qrsim.control.setpoints import Estimate
from qrsim.core.pairs import added
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import computed, record, replace, select
from qrsim.core.vectors import Euler, Vec3

# Share of turns about the level axes that is not turned back.
BACK = 0.1
# Covariance, mean errors, time since a fix that was believed, innovations, and variances of slow errors.
Corrected = tuple[Covariance, Array, Array, Innovations, Any]


@record
class ErrorStateKalmanFilter(KalmanParameters):
    """Position, velocity, attitude and the biases of gyroscope and accelerometer, with their covariance.

    With a magnetometer the Earth's field and its bias are estimated too, with an airspeed sensor the horizontal wind.
    Readings that are too far from what is expected are not believed (gates); fixes that are not for ``reset_after``
    are, and the filter begins there again. Slow errors of fixes are considered in what it reports, and not estimated.
    """

    def _delay_ticks(self, readings: Mapping[str, object]) -> int:
        """Return the delay [ticks] of the readings with a position, 0 without such readings."""
        return dict(self.ages).get(source_of(readings, "position_ned"), 0)

    @computed
    def first_normals(self) -> int:
        """Number of standard normals that the filter draws for each vehicle at the start of an episode."""
        return NORMALS if self.start == "aligned" or self.calibration_time > 0.0 else 0

    def init(self, readings: Mapping[str, object], start: Estimate) -> tuple[KalmanState, Estimate]:
        """Return state and estimate (n,) from the first readings, without gyroscope calibration or random errors."""
        return self.begin(readings, start, None)

    def begin(
        self, readings: Mapping[str, object], start: Estimate, preflight: Preflight | None
    ) -> tuple[KalmanState, Estimate]:
        """Return state and estimate (n,) from the first readings, or from ``start`` where one is missing (eq. F7)."""
        fix, velocity = field_of(readings, "position_ned"), field_of(readings, "velocity_ned")
        height, rates = field_of(readings, "height"), field_of(readings, "rates_body")
        position = start.position_ned if fix is None else known(fix, start.position_ned)
        # With a bias the first height is that of the fix, so that the two are wrong independently.
        by_height = height is not None and not self.height_bias
        if height is not None and by_height:
            position = replace(position, z=known(-height, start.position_ned.z))
        speed = start.velocity_ned if velocity is None else known(velocity, start.velocity_ned)
        zero = jnp.zeros_like(position.x)
        none = Vec3(zero, zero, zero)
        begun, turn = self._first_attitude(readings, start.attitude, zero, preflight)
        bias = calibrated(self, preflight)
        inner = self._first_inner(readings, begun, none, preflight)
        first = self.first_inner(inner, bias is not None)
        spread = self._variances(readings, "position_ned", zero, by_height)
        covariance = independent(
            [*spread, *self._variances(readings, "velocity_ned", zero), *turn, *(self._as(zero, std) for std in first)]
        )
        state = KalmanState(
            position, none, speed, begun, inner if bias is None else replace(inner, gyroscope_bias=bias),
            none if rates is None else known(rates, none), Vec3(zero, zero, zero - self.gravity), covariance,
            Vec3(zero, zero, zero + 1.0), zero,
            Innovations(
                zero, zero, zero, zero, None if inner.earth_field_ned is None else zero,
                None if inner.wind_north is None else zero,
            ),
            (Past(position, none, speed),) * self._delay_ticks(readings), self._slow(spread, by_height, zero),
        )  # fmt: skip
        if preflight is not None and preflight.at_rest is not None and self.start == "aligned":
            state = select(preflight.at_rest, levelled(self, state, readings), state)
        return state, _estimate(state)

    def _first_attitude(
        self, readings: Mapping[str, object], true: Euler, zero: Array, preflight: Preflight | None
    ) -> tuple[Quaternion, list[Array]]:
        """Return the initial attitude (n,) for a start in flight, and its error variance [rad^2] about NED axes."""
        attitude = field_of(readings, "attitude")
        heading = self.heading_std if attitude is None else self.yaw_std
        begun = Quaternion.of(true if attitude is None else replace(true, yaw=known(attitude.yaw, true.yaw)))
        if preflight is not None and self.start == "aligned":
            # The yaw of a reading has an error of its own.
            drawn = self.heading_std if attitude is None else zero
            begun = turned_by((self.tilt_std, self.tilt_std, drawn), preflight.normals[:3], begun)
        return begun, [self._as(zero, std) for std in (self.tilt_std, self.tilt_std, heading)]

    def _slow(self, place: tuple[Array, ...], by_height: bool, zero: Array) -> Vec3:
        """Return the variance (n,) [m^2] of each axis' slow position error, which the covariance omits; 0 for white."""
        level, _, down = place if self.gnss_errors == "coloured" else (zero, zero, zero)
        return Vec3(level, level, self._as(zero, self.height_drift_std) if by_height else down)

    def _first_inner(
        self, readings: Mapping[str, object], turned: Quaternion, none: Vec3, preflight: Preflight | None
    ) -> Inner:
        """Return the initial values (n,) of biases, magnetic field, wind and height error that sensors observe."""
        field, zero = field_of(readings, FIELD), none.x
        inner = Inner(none, none)
        if field is not None and self.magnetometer == "field":
            earth = self._earth_field(known(field, none), turned)
            if preflight is not None and self.start == "aligned":
                earth = earth + Vec3(*(self.earth_field_std * normal for normal in preflight.normals[6:9]))
            inner = replace(inner, earth_field_ned=earth, field_bias=none)
        if field_of(readings, AIRSPEED) is not None:
            inner = replace(inner, wind_north=zero, wind_east=zero)
        if self.height_bias and field_of(readings, "height") is not None:
            inner = replace(inner, height_bias=zero)
        return inner

    def _earth_field(self, field: Vec3, turned: Quaternion) -> Vec3:
        """Return the site's magnetic field (n,) NED [uT] if known, else the first reading rotated to NED."""
        if self.earth_field_ned is None:
            return turned.rotation().to_ned(field)
        return self.earth_field_ned.map(lambda axis: jnp.zeros_like(field.x) + axis)

    def step(
        self, state: KalmanState, readings: Mapping[str, object], fresh: Mapping[str, Array], dt: float
    ) -> tuple[KalmanState, Estimate]:
        """Return the state after prediction by dt [s] and correction by new readings (n,), and the estimate (n,)."""
        past = (*state.past, Past(state.position_ned, state.position_low_ned, state.velocity_ned))
        state = replace(self._predicted(state, readings, dt), past=past[1:] if state.past else ())
        state = self._measured(state, readings, fresh, dt)
        return state, _estimate(state)

    def std(self, state: KalmanState) -> Estimate:
        """Return the standard deviations (n,) of position, velocity and attitude, as the filter reports them."""
        one = jnp.ones_like(state.since_fix)
        unseen = self._unseen(state)
        own = variances(state.covariance)[:TURN]
        own = [jnp.sqrt(variance + along(unseen, {k: one})) for k, variance in enumerate(own)]
        rows = of_angles(state.rotation)
        angles = [jnp.sqrt(jnp.maximum(variance_of(state.covariance, row), 0.0) + along(unseen, row)) for row in rows]
        return Estimate(Vec3(*own[:SPEED]), Vec3(*own[SPEED:]), Euler(*angles))

    def inner(self, state: KalmanState) -> tuple[Inner, Inner]:
        """Return the estimated biases, magnetic field and wind (n,), and their standard deviations."""
        unseen = self._unseen(state)
        return state.inner, inner_std(state, [along(unseen, {k: 1.0}) for k in range(GYROSCOPE, SIZE)])

    def consistency(self, state: KalmanState, truth: Truth) -> Consistency:
        """Return the NEES (n,) of position, velocity, attitude and biases: squared errors over the covariance."""
        biases = (truth.gyroscope_bias, truth.accelerometer_bias)
        known_biases = None not in biases
        position_error = truth.position_ned - state.position_ned - state.position_low_ned
        if truth.position_low_ned is not None:
            position_error = position_error + truth.position_low_ned
        parts = [position_error, truth.velocity_ned - state.velocity_ned, turned(truth.attitude, state.attitude)]
        if known_biases:
            own = (state.inner.gyroscope_bias, state.inner.accelerometer_bias)
            parts += [bias - mean for bias, mean in zip(biases, own, strict=True) if bias is not None]
        whole = with_unseen(matrix(state.covariance), self._unseen(state))
        return of_blocks(whole, [axis for part in parts for axis in part.axes], known_biases)

    def _unseen(self, state: KalmanState) -> list[Unseen]:
        """Return the errors that no sensor can observe, kept outside the covariance."""
        return unseen(state, self.accelerometer_scale, self.gyroscope_g_sensitivity, self.gravity)

    def innovations(self, state: KalmanState) -> Innovations:
        """Return the last innovation of each kind of reading (n,), in standard deviations."""
        return state.innovations

    def _as(self, like: Array, std: Array) -> Array:
        """Return the variance ``std`` squared, broadcast to the shape of ``like``."""
        return jnp.zeros_like(like) + std * std

    def _variances(
        self, readings: Mapping[str, object], what: str, like: Array, by_height: bool = False
    ) -> tuple[Array, Array, Array]:
        """Return the variance (n,) of each axis of a fix's field ``what``, by its reported accuracy if it has one."""
        if what == "velocity_ned":
            stated = field_of(readings, "speed_accuracy")
            level = down = self._as(like, self.velocity_std)
            if stated is not None:
                # Of all axes together; how much of it is down, the dilutions of the fix say.
                of_level, of_down = _shares(readings)
                level, down = (known(share * stated * stated, level) for share in (of_level, of_down))
            return level, level, down
        level = self._as(like, self.position_std)
        down = self._as(like, self.height_std if by_height else self.vertical_std)
        if (stated := field_of(readings, "horizontal_accuracy")) is not None:
            # Of both axes together.
            level = known(0.5 * stated * stated, level)
        if not by_height and (stated := field_of(readings, "vertical_accuracy")) is not None:
            down = known(stated * stated, down)
        return level, level, down

    def _predicted(self, state: KalmanState, readings: Mapping[str, object], dt: float) -> KalmanState:
        """Return the state dt [s] later by body rates and mean specific force, with its covariance (eq. F1)."""
        zero = jnp.zeros_like(state.since_fix)
        rates, force = field_of(readings, "rates_body"), field_of(readings, "specific_force")
        rates = state.rates_body if rates is None else known(rates, state.rates_body)
        # A mean over the tick is that of both its ends already.
        mean = rates if field_of(readings, "delta_angle") is not None else 0.5 * (rates + state.rates_body)
        turning = mean - state.inner.gyroscope_bias
        half = turning * (0.5 * dt)
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
        lean, leant = leaned(state.lean, after, dt)
        noise = self._noise(state.inner, turning, rates - state.rates_body, change, leant, dt)
        covariance = propagated(state.covariance, moves(felt, after, dt), noise)
        return replace(
            state, position_ned=position, position_low_ned=low, velocity_ned=state.velocity_ned + change,
            attitude=attitude, rates_body=rates, force_ned=felt, since_fix=state.since_fix + dt, covariance=covariance,
            lean=lean,
        )  # fmt: skip

    def _noise(self, inner: Inner, turning: Vec3, swing: Vec3, change: Vec3, leant: Array, dt: float) -> list[Array]:
        """Return the process noise variance that one tick of dt [s] adds to each error state (eq. F1)."""
        # Roll and pitch mostly turn back, and with them the errors of scale and misalignment.
        turned = (jnp.abs(turning.z) + BACK * (jnp.abs(turning.x) + jnp.abs(turning.y))) * dt
        missed = self.sampling * dt
        turn = self._as(turned, self.gyroscope_scale) * turned + missed * missed * swing.dot(swing)
        speed = self._as(turned, self.accelerometer_scale) * change.dot(change) * (1.0 / dt)
        of_motion = (0.0 * self.accelerometer_noise, self.accelerometer_noise, self.gyroscope_noise)
        stds = [*(std for std in of_motion for _ in range(3)), *self.walks(inner)]
        found = [std * std * dt for std in stds]
        # The gyroscope's bias depends on the attitude, by its sensitivity to the specific force.
        lever = self._as(leant, self.gyroscope_g_sensitivity * self.gravity) * leant
        more = {SPEED: speed, TURN: turn, GYROSCOPE: lever}
        if inner.earth_field_ned is not None:
            earth = inner.earth_field_ned
            more[SIZE + BLOCK] = self._as(turned, self.field_scale) * earth.dot(earth) * turned
        return [
            part + more[BLOCK * (k // BLOCK)] if BLOCK * (k // BLOCK) in more else part for k, part in enumerate(found)
        ]

    def _measured(
        self, state: KalmanState, readings: Mapping[str, object], fresh: Mapping[str, Array], dt: float
    ) -> KalmanState:
        """Return the state corrected by all new readings (eq. F2)."""
        none = jnp.zeros((state.places.size, *state.since_fix.shape), state.since_fix.dtype)
        carry: Corrected = (state.covariance, none, state.since_fix, state.innovations, state.slow)
        for what, scalars, new, due in self._groups(state, readings, fresh, dt):
            believe = partial(self._believed, what, scalars, new)
            # Nothing is computed between two readings of a sensor. If vehicles have different times, all are computed.
            carry = lax.cond(due, believe, lambda carry: carry, carry) if due.ndim == 0 else believe(carry)
        covariance, errors, since_fix, innovations, slow = carry
        state = replace(state, covariance=covariance, since_fix=since_fix, innovations=innovations, slow=slow)
        return injected(state, errors, dt)

    def _believed(self, what: str, scalars: list[Measured], new: Array, carry: Corrected) -> Corrected:
        """Return ``carry`` updated by the measurements of one kind of reading, where they pass the innovation gate."""
        covariance, errors, since_fix, innovations, slow = carry
        for scalar in scalars:
            new = new & jnp.isfinite(scalar.innovation)
        known = crossed(covariance, scalars)
        worst = _worst(known, errors, scalars)
        believed = new & (worst <= self.gate * self.gate)
        if what == "position_ned":
            again = new & ~believed & (since_fix > self.reset_after)
            covariance, believed = lost(covariance, [s.variance for s in scalars], again), believed | again
            since_fix = jnp.where(believed, 0.0, since_fix)
            if slow is not None and self.gnss_errors == "coloured":
                covariance, slow = _with_accuracy(covariance, slow, [s.variance for s in scalars], believed)
            known = crossed(covariance, scalars)
        covariance, errors = corrected(covariance, errors, scalars, believed, known)
        shown = jnp.where(new, jnp.sqrt(worst), getattr(innovations, what))
        return covariance, errors, since_fix, replace(innovations, **{what: shown}), slow

    def _groups(
        self, state: KalmanState, readings: Mapping[str, object], fresh: Mapping[str, Array], dt: float
    ) -> Iterator[tuple[str, list[Measured], Array, Array]]:
        """Yield (kind, scalar measurements, (n,) bool: reading is new, bool: sensor is due), by kind of reading."""
        one = jnp.ones_like(state.since_fix)

        def new(field: str) -> tuple[Array, Array]:
            """Return (n,) bool: the reading with ``field`` is new, and its sensor's flag, from which that follows."""
            due = fresh[source_of(readings, field)]
            return due & (one > 0.0), due

        yield from self._by_fix(state, readings, new, dt)
        height, field, attitude = (field_of(readings, name) for name in ("height", FIELD, "attitude"))
        if height is not None:
            yield "height", heights(state, height, self._as(one, self.height_std)), *new("height")
        if field is not None and state.places.field is not None:
            yield "field", fields(state, field, self._as(one, self.field_std)), *new(FIELD)
        elif field is not None:
            yield "yaw", compass(state, field, self.declination, self._as(one, self.yaw_std)), *new(FIELD)
        elif attitude is not None:
            yield "yaw", headings(state, attitude, self._as(one, self.yaw_std)), *new("attitude")
        airspeed = field_of(readings, AIRSPEED)
        if airspeed is not None:
            heard, due = new(AIRSPEED)
            fast = heard & (airspeed >= self.airspeed_least)
            yield "airspeed", airspeeds(state, airspeed, self._as(one, self.airspeed_std)), fast, due

    def _by_fix(
        self, state: KalmanState, readings: Mapping[str, object], new: Callable[[str], tuple[Array, Array]], dt: float
    ) -> Iterator[tuple[str, list[Measured], Array, Array]]:
        """Yield the measurements of a GNSS fix's position and velocity, of the tick at which it was taken (eq. F2)."""
        one = jnp.ones_like(state.since_fix)
        late = dt * len(state.past)
        fix, velocity = field_of(readings, "position_ned"), field_of(readings, "velocity_ned")
        if fix is not None:
            # With a barometer without bias, the fix does not measure the height.
            axes = "xy" if field_of(readings, "height") is not None and not self.height_bias else "xyz"
            variances = self._variances(readings, "position_ned", one)
            yield "position_ned", places(state, fix, variances, axes, late), *new("position_ned")
        if velocity is not None:
            variances = self._variances(readings, "velocity_ned", one)
            yield "velocity_ned", velocities(state, velocity, variances, late), *new("velocity_ned")


def _worst(known: list[Array], errors: Array, scalars: list[Measured]) -> Array:
    """Return the largest squared innovation (n,) of some scalar measurements, each over its predicted variance."""
    worst = jnp.zeros_like(scalars[0].innovation)
    for scalar, column in zip(scalars, known, strict=True):
        left = scalar.innovation - expected(errors, scalar.sensitivity)
        spread = expected(column, scalar.sensitivity) + scalar.variance
        worst = jnp.maximum(worst, left * left / spread)
    return worst


def _with_accuracy(covariance: Covariance, slow: Vec3, stated: list[Array], where: Array) -> tuple[Covariance, Vec3]:
    """Return covariance and slow variances [m^2] updated to a fix's reported variances, where ``where`` (n,) is True.

    Accuracies that change are those of another slow error, of which a part of the position is not known.
    """
    after = [
        *(jnp.where(where, new, old) for new, old in zip(stated, slow.axes, strict=False)),
        *slow.axes[len(stated) :],
    ]
    jump = {PLACE + i: jnp.abs(new - old) for i, (new, old) in enumerate(zip(after, slow.axes, strict=True))}
    return widened(covariance, {k: jump[k] for k in list(jump)[: len(stated)]}), Vec3(*after)


def _shares(readings: Mapping[str, object]) -> tuple[Array | float, Array | float]:
    """Return the share of a fix's variance on each horizontal axis and on down, by HDOP and VDOP; else 1/3 each."""
    level, down = field_of(readings, "hdop"), field_of(readings, "vdop")
    if level is None or down is None:
        return 1.0 / 3.0, 1.0 / 3.0
    level, down = jnp.maximum(level * level, 1e-6), jnp.maximum(down * down, 1e-6)
    return 0.5 * level / (level + down), down / (level + down)


def _estimate(state: KalmanState) -> Estimate:
    """Return position, velocity and attitude (n,) of the filter's state as an estimate."""
    return Estimate(state.position_ned, state.velocity_ned, state.attitude.euler(), state.position_low_ned)
