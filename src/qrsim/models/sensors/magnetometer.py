"""The sensor ``magnetometer``: Earth's field in the axes of a chip on a vehicle with steel and currents (S21 to S23).

    y = sat_q( (I + E)(B + steel) + hard iron + current f + drift + n )

E has scale and soft iron on its diagonal, soft iron, which is symmetric, and misalignment beside it; f is the thrust
per weight. ``earth_field_ned`` of a magnetometer is the field of site and date, B above, which an estimator may know:
the true direction of what is measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar, Literal, cast

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Noise, ou_step
from qrsim.core.presets import Presets
from qrsim.core.tree import derived, parameter, quantity, record, record_of, replace, setting
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.models.sensors.contracts import Memoryless, Sensor
from qrsim.models.sensors.magnetometer_presets import PRESETS, default
from qrsim.models.sensors.quantization import quantized
from qrsim.models.vehicles.contracts import Load

# Where no site is known: that of the default site in summer 2026, rounded.
USUAL_FIELD = record_of(Vec3, 19.4, 0.4, 45.2)
# Normals of a start: hard iron, soft iron, E of the chip, current, drift.
_ONCE = 3 + 6 + 9 + 3 + 3
_AXES = 3

Rows = tuple[Vec3, Vec3, Vec3]


def _number(name: str, unit: str, doc: str) -> Array:
    """Return the field declaration of a parameter, at least 0, with the default preset's value as default."""
    return parameter(default=default(name), unit=unit, doc=doc, minimum=0.0)


def _structure(name: str, unit: str, doc: str) -> float:
    """Return the field declaration of a setting, at least 0, with the default preset's value as default."""
    return setting(default=default(name), unit=unit, doc=doc, minimum=0.0)


@record
class MagnetometerReading:
    """Magnetic field as measured."""

    field_body: Vec3 = quantity(unit="uT", doc="measured magnetic field in body axes, mean since the last reading")


@record
class Steel:
    """Solid steel near which vehicles fly, as spheres (m,)."""

    centre_ned: Vec3 = quantity(unit="m", doc="(m,) centres")
    radius: Array = quantity(unit="m", doc="(m,) radii")

    def field_ned(self, earth: Vec3, position_ned: Vec3) -> Vec3:
        """Return the field (n,) NED that steel objects add to Earth's at positions (n,) [m], in the unit of Earth's.

        Outside of a sphere that conducts a magnetic field far better than air that is the field of a dipole,
        (a/r)^3 (3 (B r) r/r^2 - B) (Jackson, Classical Electrodynamics, 3rd ed., 5.11). Inside it is held.
        """
        offset = position_ned.map(lambda axis: axis[None, :]) - self.centre_ned.map(lambda axis: axis[:, None])
        radius = jnp.asarray(self.radius)[:, None]
        square = jnp.maximum(offset.dot(offset), radius * radius)
        share = radius / jnp.sqrt(square)
        share = share * share * share
        along = 3.0 * offset.dot(earth) / square
        return Vec3(*(jnp.sum(share * (along * r - b), axis=0) for r, b in zip(offset.axes, earth.axes, strict=True)))


@record
class MagnetometerState:
    """State of n chips."""

    error: Rows = quantity(unit="1", doc="rows of E")
    offset: Vec3 = quantity(unit="uT", doc="hard iron")
    current: Vec3 = quantity(unit="uT", doc="field of the motors' currents in hover")
    drift: Vec3 = quantity(unit="uT", doc="slow error")


@record
class Magnetometer(Sensor):
    """Earth's magnetic field, with the errors of the chip and of its vehicle.

    Parameters that are not given are those of the preset. What is drawn once, as hard iron, is drawn for each vehicle
    and episode: what a calibration has left. A reading is the mean of the chip's samples over its period.
    """

    preset: Literal["hmc5883l", "ist8310", "lis3mdl", "rm3100"] = setting(
        default="rm3100", doc="chip that provides the parameters left out"
    )
    noise: Array = _number("noise", "uT/sqrt(Hz)", "N, white noise")
    drift_std: Array = _number("drift_std", "uT", "stationary std of the slow error of each axis")
    drift_time_constant: Array = parameter(
        default=default("drift_time_constant"), unit="s", doc="time constant of the slow error", above=0.0
    )
    scale: Array = _number("scale", "1", "std of the scale error of each axis")
    misalignment: Array = _number("misalignment", "rad", "std of each angle between axes")
    hard_iron: Array = parameter(
        default=0.5, unit="uT", doc="std per episode and axis of the field of the vehicle's magnets", minimum=0.0
    )
    soft_iron: Array = parameter(
        default=0.01, unit="1", doc="std of each element of the field's distortion by the vehicle's steel", minimum=0.0
    )
    interference: Array = parameter(
        default=1.0,
        unit="uT",
        doc="field of the motors' currents in hover, proportional to the thrust, in a direction drawn for each vehicle",
        minimum=0.0,
    )
    interference_x: Array = parameter(
        default=0.0, unit="uT", doc="further field of the motors' currents in hover, along body x"
    )
    interference_y: Array = parameter(default=0.0, unit="uT", doc="the same, along body y")
    interference_z: Array = parameter(default=0.0, unit="uT", doc="the same, along body z")
    range: float = _structure("range", "uT", "largest field of an axis; 0: any")
    resolution: float = _structure("resolution", "uT", "step of a sample; 0: none")
    sample_rate: float = setting(
        default=default("sample_rate"),
        unit="Hz",
        doc="sample rate of the chip; a reading is the mean of its samples, and its steps are finer by their number",
        above=0.0,
    )
    period: float = setting(
        default=0.1, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    earth_field_ned: Vec3 = derived(default=USUAL_FIELD, doc="field of the site and date [uT], in NED")
    steel: Steel | None = derived(default=None, doc="steel obstacles (Steel); None without any")
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "attitude", "load")
    normals: ClassVar[int] = 2 * _AXES
    first_normals: ClassVar[int] = _ONCE + _AXES
    presets: ClassVar[Presets] = PRESETS

    def white_noise(self) -> dict[str, Array]:
        """Return the standard deviation of a reading's white noise, {field: std}."""
        return {"field_body": self.noise / math.sqrt(self.period)}

    def init(
        self, draw: Noise, position_ned: Vec3, attitude: Euler, load: Load
    ) -> tuple[MagnetometerState, MagnetometerReading]:
        """Return state and first reading of magnetometers that have just been switched on."""
        normals = draw.normals(self.first_normals)
        given = iter(normals)
        offset = _vector(given, self.hard_iron)
        error = self._errors(given)
        direction = _vector(given, 1.0)
        current = direction * (self.interference / jnp.maximum(direction.norm(), 1e-6))
        drift = _vector(given, self.drift_std)
        known = Vec3(self.interference_x, self.interference_y, self.interference_z)
        state = MagnetometerState(error, offset, current + known, drift)
        return state, self._measured(state, normals[_ONCE:], position_ned, attitude, load)

    def restart(
        self, state: MagnetometerState, draw: Noise, since: Array, position_ned: Vec3, attitude: Euler, load: Load
    ) -> tuple[MagnetometerState, MagnetometerReading]:
        """Return state and reading of the same magnetometers after ``set_state`` has moved their vehicles."""
        normals = draw.normals(self.first_normals)[_ONCE:]
        return state, self._measured(state, normals, position_ned, attitude, load)

    def step(
        self, state: MagnetometerState, draw: Noise, position_ned: Vec3, attitude: Euler, load: Load
    ) -> tuple[MagnetometerState, MagnetometerReading]:
        """Return state and reading one period later, with the slowly varying error drifted."""
        normals = draw.normals(self.normals)
        drift = Vec3(
            *(
                ou_step(now, normal, self.period, self.drift_std, self.drift_time_constant)
                for now, normal in zip(state.drift.axes, normals[_AXES:], strict=True)
            )
        )
        state = replace(state, drift=drift)
        return state, self._measured(state, normals, position_ned, attitude, load)

    def _errors(self, given: Iterator[Array]) -> Rows:
        """Return the rows of a random 3 x 3 error matrix: soft iron, scale and misalignment, from normals ``given``."""
        xx, yy, zz, xy, xz, yz = (self.soft_iron * next(given) for _ in range(6))
        rows = []
        for i, soft in enumerate(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))):
            own = ((self.scale if i == j else self.misalignment) * next(given) for j in range(_AXES))
            rows.append(Vec3(*(a + b for a, b in zip(soft, own, strict=True))))
        return cast(Rows, tuple(rows))

    def _measured(
        self, state: MagnetometerState, normals: tuple[Array, ...], position_ned: Vec3, attitude: Euler, load: Load
    ) -> MagnetometerReading:
        """Return the reading, the field in body axes [uT] with all errors, for a sensor state and normals (n,)."""
        field = true_field_body(self.earth_field_ned, self.steel, position_ned, attitude)
        thrust = load.per_weight(position_ned.x)
        spread = self.noise * (1.0 / math.sqrt(self.period))
        step = self.resolution / max(1.0, self.sample_rate * self.period)
        axes = []
        for row, axis, normal, offset, current, drift in zip(
            state.error,
            field.axes,
            normals[:_AXES],
            state.offset.axes,
            state.current.axes,
            state.drift.axes,
            strict=True,
        ):
            value = axis + row.dot(field) + offset + current * thrust + drift + spread * normal
            axes.append(quantized(value, self.range, step))
        return MagnetometerReading(Vec3(*axes))


@record
class IdealMagnetometer(Memoryless):
    """The truth at the same period: Earth's field and that of steel obstacles, in body axes."""

    period: float = setting(
        default=0.1, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    earth_field_ned: Vec3 = derived(default=USUAL_FIELD, doc="field of the site and date [uT], in NED")
    steel: Steel | None = derived(default=None, doc="steel obstacles (Steel); None without any")
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "attitude", "load")

    def init(self, draw: Noise, position_ned: Vec3, attitude: Euler, load: Load) -> tuple[None, MagnetometerReading]:
        """Return None as state, and the reading: the true field in body axes."""
        return None, MagnetometerReading(true_field_body(self.earth_field_ned, self.steel, position_ned, attitude))


def true_field_body(earth: Vec3, steel: Steel | None, position_ned: Vec3, attitude: Euler) -> Vec3:
    """Return the true magnetic field (n,) in body axes, Earth's plus that of steel, in the unit of ``earth``."""
    like = position_ned.x
    field = earth.map(lambda axis: jnp.broadcast_to(jnp.asarray(axis, like.dtype), like.shape))
    if steel is not None:
        field = field + steel.field_ned(earth, position_ned)
    return rotation(attitude).to_body(field)


def _vector(given: Iterator[Array], std: Array | float) -> Vec3:
    """Return a vector of the next three normals of ``given``, times a standard deviation."""
    return Vec3(*(std * next(given) for _ in range(_AXES)))
