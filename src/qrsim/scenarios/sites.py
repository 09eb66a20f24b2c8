"""What sensors of a scenario are in: Earth's field of its site and date, its steel obstacles, the air of its height."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from qrsim.core.tree import record_of, replace
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.standard import SiteAir, temperature
from qrsim.models.sensors.airspeed import Airspeed, IdealAirspeed
from qrsim.models.sensors.earth_field import covers, earth_field_ned, years
from qrsim.models.sensors.magnetometer import IdealMagnetometer, Magnetometer, Steel
from qrsim.models.sensors.pressure import IdealPressureAltimeter, PressureAltimeter
from qrsim.models.site import Site
from qrsim.models.vehicles.contracts import Vehicle
from qrsim.scenarios.schema import ScenarioSpec
from qrsim.scenarios.spacing import columns

MAGNETOMETERS = ("magnetometer", "ideal_magnetometer")


def site_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error if a magnetometer needs the Earth's field at a start time that no magnetic model covers."""
    for name, fleet in scenario.fleets.items():
        for sensor_name, sensor in fleet.sensors.items():
            if sensor.type in MAGNETOMETERS and not covers(scenario.start_time):
                yield (
                    f"start_time: {scenario.start_time:%Y-%m-%d} is outside the World Magnetic Model, which "
                    f"fleets.{name}.sensors.{sensor_name} needs; allowed: {years()}"
                )
                return


def air_of(scenario: ScenarioSpec) -> SiteAir:
    """Return the model of the atmosphere above the scenario's site, for its day."""
    return SiteAir.of(altitude_of(scenario), scenario.site.temperature_offset)


def altitude_of(scenario: ScenarioSpec) -> float:
    """Return the site's altitude in the standard atmosphere [m]: its height above mean sea level, if known.

    A site with a height above the ellipsoid alone has the air of that height, which differs by the geoid's.
    """
    site = scenario.site
    return site.height if site.height_amsl is None else site.height_amsl


def at_site(sensor: object, scenario: ScenarioSpec, vehicle: Vehicle) -> object:
    """Return a sensor with the site's magnetic field, air and steel obstacles filled in, if it has such parameters."""
    if isinstance(sensor, Magnetometer | IdealMagnetometer):
        place = scenario.site
        site = Site.from_degrees(place.latitude_deg, place.longitude_deg, place.height)
        field = earth_field_ned(site, scenario.start_time)
        return replace(sensor, earth_field_ned=Vec3(*field), steel=_steel(scenario))
    if isinstance(sensor, PressureAltimeter | IdealPressureAltimeter | Airspeed | IdealAirspeed):
        air = air_of(scenario)
        sensor = replace(sensor, site_temperature=air.temperature, site_pressure=air.pressure)
    if isinstance(sensor, PressureAltimeter):
        # Its height is that of the standard atmosphere, whatever the day.
        offset = scenario.site.temperature_offset
        sensor = replace(sensor, site_temperature=temperature(altitude_of(scenario)), site_warmer=offset)
        outline = vehicle.outline()
        if outline is not None and outline.rotor_radius > 0.0:
            sensor = replace(sensor, vehicle_rotor=2.0 * outline.rotor_radius)
    return sensor


def _steel(scenario: ScenarioSpec) -> Steel | None:
    """Return the steel obstacles of a scenario, which disturb magnetometers, as one record; None without any."""
    solid = [each for each in scenario.world.obstacles if each.steel_radius > 0.0]
    if not solid:
        return None
    centres = [_centre(each) for each in solid]
    return record_of(Steel, columns(centres), np.array([each.steel_radius for each in solid]))


def _centre(obstacle: Any) -> list[float]:
    """Return the centre NED [m] of an obstacle: the mean of its corners, half way up."""
    if obstacle.type == "box":
        level = [0.5 * (obstacle.x_min + obstacle.x_max), 0.5 * (obstacle.y_min + obstacle.y_max)]
    elif obstacle.type == "cylinder":
        level = [obstacle.x, obstacle.y]
    else:
        level = np.mean(obstacle.corners_ned, axis=0).tolist()
    return [*level, 0.5 * (obstacle.z_min + obstacle.z_max)]
