"""The sensor ``pressure_altimeter``: a barometer that feels weather, wind and rotors (S26, S27).

``barometer`` is the published one, a height with a drift. This one has a pressure, from which its height follows by the
standard atmosphere: what acts on the pressure acts on the height.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Noise, ou_step
from qrsim.core.presets import Presets
from qrsim.core.tree import derived, parameter, quantity, record, replace, setting
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.models.atmosphere.standard import GAS, GRAVITY, LAPSE, PRESSURE, TEMPERATURE, air_above
from qrsim.models.scene.contracts import Ground
from qrsim.models.sensors.air_presets import ALTIMETERS, default_altimeter
from qrsim.models.sensors.contracts import Memoryless, Sensor
from qrsim.models.vehicles.contracts import Load


def _port(side: str) -> Array:
    """Return the field declaration of the static port's pressure coefficient for air from side ``side``."""
    return parameter(
        default=-0.1, unit="1", doc=f"pressure at the port relative to the dynamic pressure, for air {side}"
    )


@record
class PressureReading:
    """Static pressure, and the height that it means in the standard atmosphere."""

    height: Array = quantity(unit="m", doc="pressure altitude above that of the site's origin, positive up")
    height_rate: Array = quantity(unit="m/s", doc="rate of change of that altitude, low-passed, positive up")
    pressure: Array = quantity(unit="Pa", doc="measured static pressure")
    temperature: Array = quantity(unit="K", doc="temperature of the air")


@record
class PressureState:
    """State of n altimeters."""

    drift: Array = quantity(unit="m", doc="drift by the weather")
    offset: Array = quantity(unit="Pa", doc="error of the chip")
    height: Array = quantity(unit="m", doc="previous reading")
    rate: Array = quantity(unit="m/s", doc="low-passed rate")


@record
class PressureAltimeter(Sensor):
    """Static pressure and pressure altitude, with errors of chip, weather, wind and rotors.

    Parameters that are not given are those of the preset. The chip's offset is in the pressure, and in the height only
    where this is not set to that of the site at the start, as autopilots do (``zeroed``).
    """

    preset: Literal["ms5611", "bmp280", "bmp390"] = setting(
        default="ms5611", doc="chip that provides the parameters left out"
    )
    noise_std: Array = parameter(
        default=default_altimeter("noise_std"), unit="Pa", doc="white noise of each reading", minimum=0.0
    )
    offset_std: Array = parameter(
        default=default_altimeter("offset_std"), unit="Pa", doc="std of the offset per episode", minimum=0.0
    )
    drift_std: Array = parameter(default=0.26, unit="m", doc="stationary std of the weather's drift", minimum=0.0)
    drift_time_constant: Array = parameter(default=300.0, unit="s", doc="time constant of the drift", above=0.0)
    warmer: Array = parameter(
        default=0.0, unit="K", doc="air temperature in addition to site.temperature_offset", minimum=-60.0, maximum=60.0
    )
    port_forward: Array = _port("from ahead")
    port_backward: Array = _port("from behind")
    port_right: Array = _port("from the right")
    port_left: Array = _port("from the left")
    port_vertical: Array = parameter(
        default=0.0, unit="1", doc="the same for air from below; with the opposite sign for air from above"
    )
    rotor_wash: Array = parameter(
        default=-6.0, unit="Pa", doc="pressure by the rotors' flow in hover, proportional to the thrust"
    )
    ground_effect: Array = parameter(
        default=12.0,
        unit="Pa",
        doc="pressure under the rotors in hover on the ground; it vanishes a rotor diameter above",
    )
    rotor_diameter: Array = parameter(
        default=0.0, unit="m", doc="diameter of one rotor; 0: the vehicle's, or 0.25 m if it has none", minimum=0.0
    )
    rate_time_constant: Array = parameter(
        default=0.5, unit="s", doc="time constant of the low-pass of the height rate", minimum=0.0
    )
    zeroed: bool = setting(default=True, doc="the height is set to that of the site before the flight")
    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    site_temperature: Array = derived(default=TEMPERATURE, doc="of the standard atmosphere at the site [K]")
    site_pressure: Array = derived(default=PRESSURE, doc="of the standard atmosphere at the site [Pa]")
    site_warmer: Array = derived(default=0.0, doc="temperature of the day over that of the standard atmosphere [K]")
    vehicle_rotor: Array = derived(default=0.25, doc="diameter of one of the vehicle's rotors [m]")
    reads: ClassVar[tuple[str, ...]] = (
        "position_ned",
        "velocity_ned",
        "attitude",
        "velocity_body",
        "wind_ned",
        "load",
        "ground",
    )
    normals: ClassVar[int] = 2
    first_normals: ClassVar[int] = 3
    presets: ClassVar[Presets] = ALTIMETERS

    def init(
        self,
        draw: Noise,
        position_ned: Vec3,
        velocity_ned: Vec3,
        attitude: Euler,
        velocity_body: Vec3,
        wind_ned: Vec3,
        load: Load,
        ground: Ground,
    ) -> tuple[PressureState, PressureReading]:
        """Return state and first reading, with random drift and chip offset; the height rate is the true one."""
        white, drift, offset = draw.normals(3)
        state = PressureState(self.drift_std * drift, self.offset_std * offset, drift, drift)
        flow = (position_ned, attitude, velocity_body, wind_ned, load, ground)
        height, pressure, warmth = self._measured(state, white, *flow)
        rate = -velocity_ned.z
        return replace(state, height=height, rate=rate), PressureReading(height, rate, pressure, warmth)

    def restart(
        self,
        state: PressureState,
        draw: Noise,
        since: Array,
        position_ned: Vec3,
        velocity_ned: Vec3,
        attitude: Euler,
        velocity_body: Vec3,
        wind_ned: Vec3,
        load: Load,
        ground: Ground,
    ) -> tuple[PressureState, PressureReading]:
        """Return state and reading after ``set_state`` has moved vehicles; each altimeter keeps drift and offset."""
        white, _, _ = draw.normals(3)
        flow = (position_ned, attitude, velocity_body, wind_ned, load, ground)
        height, pressure, warmth = self._measured(state, white, *flow)
        rate = -velocity_ned.z
        # The height that it would have read then, because the next rate is that of a whole period.
        then = replace(state, height=height + velocity_ned.z * since, rate=rate)
        return then, PressureReading(height, rate, pressure, warmth)

    def step(
        self,
        state: PressureState,
        draw: Noise,
        position_ned: Vec3,
        velocity_ned: Vec3,
        attitude: Euler,
        velocity_body: Vec3,
        wind_ned: Vec3,
        load: Load,
        ground: Ground,
    ) -> tuple[PressureState, PressureReading]:
        """Return state and reading one period later: pressure height, height rate, pressure and temperature."""
        white, normal = draw.normals(2)
        drift = ou_step(state.drift, normal, self.period, self.drift_std, self.drift_time_constant)
        flow = (position_ned, attitude, velocity_body, wind_ned, load, ground)
        height, pressure, warmth = self._measured(replace(state, drift=drift), white, *flow)
        share = self.period / (self.period + jnp.asarray(self.rate_time_constant))
        rate = state.rate + share * ((height - state.height) * (1.0 / self.period) - state.rate)
        return PressureState(drift, state.offset, height, rate), PressureReading(height, rate, pressure, warmth)

    def _measured(
        self,
        state: PressureState,
        white: Array,
        position_ned: Vec3,
        attitude: Euler,
        velocity_body: Vec3,
        wind_ned: Vec3,
        load: Load,
        ground: Ground,
    ) -> tuple[Array, Array, Array]:
        """Return measured height [m], pressure [Pa] and air temperature [K], each (n,)."""
        base, above = jnp.asarray(self.site_temperature), -position_ned.z
        warmer = self.warmer + self.site_warmer
        # On a warmer day the air is thinner: a metre is less pressure.
        stands = above * (base / (base + warmer)) + state.drift
        air = air_above(stands, base, self.site_pressure)
        flow = velocity_body - rotation(attitude).to_body(wind_ned)
        felt = 0.5 * air.density * self._ports(flow) + self.noise_std * white
        felt = felt + self._by_rotors(ground.down(position_ned) + above) * load.per_weight(above)
        height = stands - air.temperature / air.pressure * (GAS / GRAVITY) * (
            felt if self.zeroed else felt + state.offset
        )
        return height, air.pressure + felt + state.offset, base - LAPSE * above + warmer

    def _ports(self, flow: Vec3) -> Array:
        """Return the static port's pressure error (n,) over half the air density, for an air flow (n,) [m/s]."""
        x, y, z = flow.axes
        along = jnp.where(x > 0.0, self.port_forward, self.port_backward) * (x * x)
        across = jnp.where(y > 0.0, self.port_right, self.port_left) * (y * y)
        return along + across + self.port_vertical * (z * jnp.abs(z))

    def _by_rotors(self, clearance: Array) -> Array:
        """Return the pressure (n,) [Pa] that rotors in hover cause at a clearance (n,) [m] above ground."""
        diameter = jnp.asarray(self.rotor_diameter)
        diameter = jnp.where(diameter > 0.0, diameter, self.vehicle_rotor)
        near = jnp.clip(1.0 - clearance / diameter, 0.0, 1.0)
        return self.rotor_wash + self.ground_effect * (near * near)


@record
class IdealPressureAltimeter(Memoryless):
    """The truth at the same period, in the standard atmosphere."""

    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    site_temperature: Array = derived(default=TEMPERATURE, doc="of the standard atmosphere at the site [K]")
    site_pressure: Array = derived(default=PRESSURE, doc="of the standard atmosphere at the site [Pa]")
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "velocity_ned", "attitude", "velocity_body", "wind_ned", "load")

    def init(
        self,
        draw: Noise,
        position_ned: Vec3,
        velocity_ned: Vec3,
        attitude: Euler,
        velocity_body: Vec3,
        wind_ned: Vec3,
        load: Load,
    ) -> tuple[None, PressureReading]:
        """Return None as state, and the reading: true height, height rate, pressure and temperature."""
        air = air_above(-position_ned.z, self.site_temperature, self.site_pressure)
        return None, PressureReading(-position_ned.z, -velocity_ned.z, air.pressure, air.temperature)
