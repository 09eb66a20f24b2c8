"""Parameters of the error-state Kalman filter, and the standard deviations that follow from them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, TypeVar

import jax.numpy as jnp
from jax import Array

from qrsim.control.contracts import Estimator
from qrsim.control.kalman_state import Inner
from qrsim.core.fastmath import arctan2
from qrsim.core.tree import derived, parameter, record, replace, setting
from qrsim.core.vectors import Vec3

Filter = TypeVar("Filter", bound="KalmanParameters")


def _sensed(default: float, unit: str, doc: str, *, positive: bool = False) -> Array:
    """Return the declaration of a filter parameter; if a scenario omits it, its value is derived from the sensors."""
    least, above = (None, 0.0) if positive else (0.0, None)
    return parameter(default=default, unit=unit, doc=doc, of_sensors=True, minimum=least, above=above)


@record
class KalmanParameters(Estimator):
    """Noise parameters of the filter: errors of the sensors, of the start and of its model."""

    gyroscope_noise: Array = _sensed(1e-3, "rad/s/sqrt(Hz)", "density of white noise")
    accelerometer_noise: Array = _sensed(0.02, "m/s^2/sqrt(Hz)", "density of white noise, vibration included")
    gyroscope_walk: Array = _sensed(2e-5, "rad/s/sqrt(s)", "random walk of its bias")
    accelerometer_walk: Array = _sensed(3e-4, "m/s^2/sqrt(s)", "random walk of its bias")
    gyroscope_bias_std: Array = _sensed(0.01, "rad/s", "of its bias when it is switched on")
    gyroscope_calibrated_std: Array = _sensed(1e-3, "rad/s", "of its bias after the calibration on the ground")
    accelerometer_bias_std: Array = _sensed(0.1, "m/s^2", "of its bias at the start")
    gyroscope_scale: Array = _sensed(0.0, "1", "error of a rate over the rate: scale and misalignment")
    accelerometer_scale: Array = _sensed(0.0, "1", "error of an acceleration over it: scale and misalignment")
    gyroscope_g_sensitivity: Array = _sensed(0.0, "rad s/m", "error of a rate over the specific force")
    position_std: Array = _sensed(1.5, "m", "of a fix, per horizontal axis, where it states no accuracy", positive=True)
    vertical_std: Array = _sensed(2.5, "m", "the same, down", positive=True)
    velocity_std: Array = _sensed(
        0.2, "m/s", "of a fix's velocity, per axis, where it states no accuracy", positive=True
    )
    height_std: Array = _sensed(0.3, "m", "white noise of a height by the barometer", positive=True)
    height_drift_std: Array = _sensed(0.0, "m", "its slow error, which the filter does not estimate")
    yaw_std: Array = _sensed(0.05, "rad", "of a heading", positive=True)
    field_bias_std: Array = _sensed(2.0, "uT", "of the bias of the magnetic field at the start, per axis")
    field_std: Array = _sensed(0.5, "uT", "of a magnetic field, per axis", positive=True)
    field_scale: Array = _sensed(0.0, "1", "error of a field over the field: soft iron, scale and misalignment")
    airspeed_std: Array = _sensed(1.0, "m/s", "of an airspeed", positive=True)
    gnss_errors: Literal["coloured", "white"] = setting(
        default="coloured",
        doc="errors of successive fixes: correlated, so that more fixes do not average them out, or white",
    )
    start: Literal["aligned", "truth"] = setting(
        default="aligned",
        doc="attitude at the start: aligned from readings on the ground and with a random error in "
        "flight, or the truth",
    )
    calibration_time: float = setting(
        default=2.0,
        unit="s",
        doc="time at rest before the flight over which the gyroscope is averaged; 0: none",
        minimum=0.0,
    )
    tilt_std: Array = parameter(
        default=0.015, unit="rad", doc="std of roll and pitch at a start in flight", minimum=0.0
    )
    heading_std: Array = parameter(default=0.03, unit="rad", doc="std of the yaw at a start in flight", minimum=0.0)
    sampling: Array = parameter(
        default=0.2,
        unit="1",
        doc="error of the rotation in a tick, relative to the change of rate within it",
        minimum=0.0,
    )
    gate: Array = parameter(
        default=5.0, unit="1", doc="innovation, in standard deviations, beyond which a reading is rejected", above=0.0
    )
    reset_after: Array = parameter(
        default=7.0, unit="s", doc="time without an accepted fix after which the next one is accepted", above=0.0
    )
    gravity: Array = parameter(default=9.81, unit="m/s^2", doc="gravitational acceleration", minimum=0.0)
    magnetometer: Literal["field", "heading"] = setting(
        default="field", doc="use of the magnetometer: three axes, with field and bias as states, or a heading"
    )
    earth_field_std: Array = parameter(
        default=0.15, unit="uT", doc="std of the Earth's field at the start, per axis", minimum=0.0
    )
    field_walk: Array = parameter(
        default=0.005,
        unit="uT/sqrt(s)",
        doc="random walk of the Earth's field along the flight, and of the bias",
        minimum=0.0,
    )
    airspeed_least: Array = parameter(
        default=5.0, unit="m/s", doc="airspeed below which readings are rejected", minimum=0.0
    )
    wind_std: Array = parameter(default=6.0, unit="m/s", doc="std of the wind at the start, per axis", minimum=0.0)
    wind_walk: Array = parameter(
        default=0.5, unit="m/s/sqrt(s)", doc="random walk of the wind, gusts included", minimum=0.0
    )
    height_bias: bool = setting(
        default=False, doc="the barometer's error is a state, so that fixes determine the height in the long run"
    )
    height_bias_std: Array = parameter(
        default=0.5, unit="m", doc="std of the barometer's error at the start", minimum=0.0
    )
    height_bias_walk: Array = parameter(
        default=0.02, unit="m/sqrt(s)", doc="random walk of the barometer's error", minimum=0.0
    )
    earth_field_ned: Vec3 | None = derived(default=None, doc="the Earth's field at the site [uT]; None: unknown")
    ages: tuple[tuple[str, int], ...] = derived(
        default=(), doc="sensors by name, and ticks their readings are late by", static=True
    )

    # Barometer, heading, magnetometer and airspeed are of use, and not needed.
    reads: ClassVar[tuple[str, ...]] = ("gnss_receiver", "accelerometer", "gyroscope")

    def fitted(self: Filter, ages: Mapping[str, int], earth_field_ned: Vec3 | None = None) -> Filter:
        """Return the filter for sensors with delays ``ages`` [ticks] by name, and the Earth's field NED [uT]."""
        return replace(self, ages=tuple(sorted(ages.items())), earth_field_ned=earth_field_ned)

    @property
    def declination(self) -> Array:
        """Declination [rad] of magnetic north from true north; 0 if the Earth's field is unknown."""
        if self.earth_field_ned is None:
            return jnp.zeros_like(self.yaw_std)
        return arctan2(self.earth_field_ned.y, self.earth_field_ned.x)

    def first_inner(self, inner: Inner, calibrated: bool) -> list[Array]:
        """Return the initial std of biases, magnetic field and wind errors, smaller for a calibrated gyroscope."""
        gyroscope = self.gyroscope_calibrated_std if calibrated else self.gyroscope_bias_std
        stds = (
            gyroscope,
            self.accelerometer_bias_std,
            self.earth_field_std,
            self.field_bias_std,
            self.wind_std,
            self.height_bias_std,
        )
        return _std_of_each_error(inner, stds)

    def walks(self, inner: Inner) -> list[Array]:
        """Return the random-walk noise density of each bias, magnetic field and wind error that the filter has."""
        stds = (
            self.gyroscope_walk,
            self.accelerometer_walk,
            self.field_walk,
            self.field_walk,
            self.wind_walk,
            self.height_bias_walk,
        )
        return _std_of_each_error(inner, stds)


def _std_of_each_error(inner: Inner, stds: tuple[Array, ...]) -> list[Array]:
    """Return the std of ``stds`` for each error state in ``inner``, in the covariance's order; 0 for unused ones."""
    *first, wind, height = stds
    own = first[:2] if inner.earth_field_ned is None else first
    found = [std for std in own for _ in range(3)]
    if inner.wind_north is not None or inner.height_bias is not None:
        known = (inner.wind_north, inner.wind_east, inner.height_bias)
        last = zip(known, (wind, wind, height), strict=True)
        found += [jnp.zeros_like(std) if part is None else std for part, std in last]
    return found
