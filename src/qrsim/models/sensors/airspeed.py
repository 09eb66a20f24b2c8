"""The sensor ``airspeed``: a pitot tube along the body's forward axis (S28, S29)."""

from __future__ import annotations

from typing import ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Noise
from qrsim.core.presets import Presets
from qrsim.core.tree import derived, parameter, quantity, record, setting
from qrsim.core.vectors import Euler, Vec3, root, rotation
from qrsim.models.atmosphere.standard import DENSITY, PRESSURE, TEMPERATURE, air_above
from qrsim.models.sensors.air_presets import AIRSPEEDS, default_airspeed
from qrsim.models.sensors.contracts import Explained, Memoryless, Sensor
from qrsim.models.sensors.quantization import quantized


def _number(name: str, unit: str, doc: str) -> Array:
    """Return the field declaration of a parameter, at least 0, with the default preset's value as default."""
    return parameter(default=default_airspeed(name), unit=unit, doc=doc, minimum=0.0)


@record
class AirspeedReading(Explained):
    """Reading of a pitot tube: pressure and airspeeds."""

    differential_pressure: Array = quantity(unit="Pa", doc="measured pressure in the tube above the static pressure")
    indicated_airspeed: Array = quantity(
        unit="m/s", doc="indicated airspeed: that of the same pressure at sea level, unsigned; NaN below speed_min"
    )
    true_airspeed: Array = quantity(
        unit="m/s", doc="true airspeed, for the standard density at its height, unsigned; NaN below speed_min"
    )

    def reason(self, vehicle: int) -> str:
        """Return as text why a vehicle has no airspeed reading, by its number."""
        return "slower than a pitot tube can measure"


@record
class AirspeedState:
    """Errors of n sensors."""

    offset: Array = quantity(unit="Pa", doc="residual offset after zeroing")
    scale: Array = quantity(unit="1", doc="error of the scale")


@record
class Airspeed(Sensor):
    """Dynamic pressure of the air from ahead, and the airspeeds computed from it.

    Parameters that are not given are those of the preset. The speeds are unsigned. Below ``speed_min``, where
    noise and offset are as large as the pressure, they are NaN.
    """

    preset: Literal["ms4525do", "sdp33"] = setting(default="sdp33", doc="chip that provides the parameters left out")
    noise_std: Array = _number("noise_std", "Pa", "white noise of each reading")
    offset_std: Array = _number("offset_std", "Pa", "std of the offset per episode")
    scale: Array = _number("scale", "1", "std of the scale error per episode, tube and hoses included")
    reverse: Array = parameter(
        default=0.3,
        unit="1",
        doc="suction by air from behind, relative to the pressure by air from ahead",
        minimum=0.0,
        maximum=1.0,
    )
    speed_min: Array = parameter(
        default=5.0, unit="m/s", doc="indicated airspeed below which the reading is NaN; 0: never NaN", minimum=0.0
    )
    range: float = setting(default=default_airspeed("range"), unit="Pa", doc="largest pressure; 0: any", minimum=0.0)
    resolution: float = setting(
        default=default_airspeed("resolution"), unit="Pa", doc="step of the pressure; 0: none", minimum=0.0
    )
    period: float = setting(
        default=0.1, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    site_temperature: Array = derived(default=TEMPERATURE, doc="of the standard atmosphere at the site [K]")
    site_pressure: Array = derived(default=PRESSURE, doc="of the standard atmosphere at the site [Pa]")
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "attitude", "velocity_body", "wind_ned")
    normals: ClassVar[int] = 1
    first_normals: ClassVar[int] = 3
    presets: ClassVar[Presets] = AIRSPEEDS

    def init(
        self, draw: Noise, position_ned: Vec3, attitude: Euler, velocity_body: Vec3, wind_ned: Vec3
    ) -> tuple[AirspeedState, AirspeedReading]:
        """Return state and first reading of airspeed sensors that have just been zeroed."""
        white, offset, scale = draw.normals(3)
        state = AirspeedState(self.offset_std * offset, self.scale * scale)
        return state, self._measured(state, white, position_ned, attitude, velocity_body, wind_ned)

    def restart(
        self,
        state: AirspeedState,
        draw: Noise,
        since: Array,
        position_ned: Vec3,
        attitude: Euler,
        velocity_body: Vec3,
        wind_ned: Vec3,
    ) -> tuple[AirspeedState, AirspeedReading]:
        """Return state and reading of the same airspeed sensors after ``set_state`` has moved their vehicles."""
        white, _, _ = draw.normals(3)
        return state, self._measured(state, white, position_ned, attitude, velocity_body, wind_ned)

    def step(
        self,
        state: AirspeedState,
        draw: Noise,
        position_ned: Vec3,
        attitude: Euler,
        velocity_body: Vec3,
        wind_ned: Vec3,
    ) -> tuple[AirspeedState, AirspeedReading]:
        """Return the state unchanged, and a new airspeed reading (n,)."""
        (white,) = draw.normals(1)
        return state, self._measured(state, white, position_ned, attitude, velocity_body, wind_ned)

    def _measured(
        self,
        state: AirspeedState,
        white: Array,
        position_ned: Vec3,
        attitude: Euler,
        velocity_body: Vec3,
        wind_ned: Vec3,
    ) -> AirspeedReading:
        """Return the airspeed reading (n,) for a sensor state and a standard normal ``white`` (n,)."""
        speed = _ahead(attitude, velocity_body, wind_ned)
        density = air_above(-position_ned.z, self.site_temperature, self.site_pressure).density
        true = 0.5 * density * (speed * speed) * jnp.where(speed > 0.0, 1.0, -jnp.asarray(self.reverse))
        found = true + true * state.scale + state.offset + self.noise_std * white
        found = quantized(found, self.range, self.resolution)
        indicated = root(jnp.abs(found) * (2.0 / DENSITY))
        told, true_speed = indicated >= self.speed_min, indicated * root(DENSITY / density)
        return AirspeedReading(found, jnp.where(told, indicated, jnp.nan), jnp.where(told, true_speed, jnp.nan))


@record
class IdealAirspeed(Memoryless):
    """The truth at the same period: the speed of the air from ahead, with its sign, however small."""

    period: float = setting(
        default=0.1, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    site_temperature: Array = derived(default=TEMPERATURE, doc="of the standard atmosphere at the site [K]")
    site_pressure: Array = derived(default=PRESSURE, doc="of the standard atmosphere at the site [Pa]")
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "attitude", "velocity_body", "wind_ned")

    def init(
        self, draw: Noise, position_ned: Vec3, attitude: Euler, velocity_body: Vec3, wind_ned: Vec3
    ) -> tuple[None, AirspeedReading]:
        """Return None as state, and the reading: the true airspeed and its differential pressure."""
        speed = _ahead(attitude, velocity_body, wind_ned)
        density = air_above(-position_ned.z, self.site_temperature, self.site_pressure).density
        pressure = 0.5 * density * (speed * jnp.abs(speed))
        return None, AirspeedReading(pressure, speed * root(density / DENSITY), speed)


def _ahead(attitude: Euler, velocity_body: Vec3, wind_ned: Vec3) -> Array:
    """Return the forward component (n,) [m/s] of a vehicle's velocity through the air."""
    return velocity_body.x - rotation(attitude).forward.dot(wind_ned)
