"""What the magnetometers of a scenario are in: Earth's field of its site and date, and its steel obstacles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.sensors.earth_field import covers, earth_field_ned, years
from qrsim.models.sensors.magnetometer import IdealMagnetometer, Magnetometer, Steel
from qrsim.models.site import Site
from qrsim.scenarios.schema import ScenarioSpec
from qrsim.scenarios.spacing import columns

TYPES = ("magnetometer", "ideal_magnetometer")


def magnetism_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield a start for which there is no model of Earth's field, where a magnetometer needs one."""
    for name, fleet in scenario.fleets.items():
        for sensor_name, sensor in fleet.sensors.items():
            if sensor.type in TYPES and not covers(scenario.start_time):
                yield (
                    f"start_time: {scenario.start_time:%Y-%m-%d} is outside the World Magnetic Model, which "
                    f"fleets.{name}.sensors.{sensor_name} needs; allowed: {years()}"
                )
                return


def in_earth_field(sensor: Any, scenario: ScenarioSpec) -> Any:
    """Return a sensor with the field at the scenario's site, if it is a magnetometer."""
    if not isinstance(sensor, Magnetometer | IdealMagnetometer):
        return sensor
    place = scenario.site
    site = Site.from_degrees(place.latitude_deg, place.longitude_deg, place.height)
    field = earth_field_ned(site, scenario.start_time)
    return replace(sensor, earth_field_ned=Vec3(*field), steel=_steel(scenario))


def _steel(scenario: ScenarioSpec) -> Steel | None:
    """Gather the obstacles of steel."""
    solid = [each for each in scenario.world.obstacles if each.steel_radius > 0.0]
    if not solid:
        return None
    centres = [_centre(each) for each in solid]
    return Steel(columns(centres), np.array([each.steel_radius for each in solid]))  # type: ignore[arg-type]


def _centre(obstacle: Any) -> list[float]:
    """Return the middle [m] of an obstacle of any kind: of its corners, and half way up."""
    if obstacle.type == "box":
        level = [0.5 * (obstacle.x_min + obstacle.x_max), 0.5 * (obstacle.y_min + obstacle.y_max)]
    elif obstacle.type == "cylinder":
        level = [obstacle.x, obstacle.y]
    else:
        level = np.mean(obstacle.corners_ned, axis=0).tolist()
    return [*level, 0.5 * (obstacle.z_min + obstacle.z_max)]
