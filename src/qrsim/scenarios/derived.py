"""What follows from the parameters of the vehicles of a scenario, for people: hover, reserves, the wind they hold."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from qrsim.models.sensors.earth_field import declination, inclination
from qrsim.models.vehicles.contracts import handling_of
from qrsim.models.vehicles.fixed_wing import FixedWing
from qrsim.models.vehicles.fixed_wing.trim import cruise, stall_speed
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.models.vehicles.multirotor.derived import derived
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.build import component
from qrsim.scenarios.scenario import Scenario
from qrsim.scenarios.sites import MAGNETOMETERS
from qrsim.scenarios.wind_limits import limits_of


def derived_of(scenario: Scenario) -> dict[str, dict[str, float]]:
    """Return derived quantities of each fleet that has some, by name; units end the names."""
    found = {}
    for name, fleet in scenario.spec.fleets.items():
        vehicle: Any = component(fleet.vehicle, known.VEHICLES, scenario.spec)
        if isinstance(vehicle, Multirotor):
            found[name] = derived(vehicle)
        elif isinstance(vehicle, FixedWing):
            found[name] = _level_flight(vehicle)
        elif (handling := handling_of(vehicle)) is not None:
            mass, gravity, most = (
                float(np.ravel(value)[0]) for value in (handling.mass, handling.gravity, handling.thrust_max)
            )
            throttle = float(np.ravel(handling.throttle(mass * gravity))[0])
            found[name] = {"mass_kg": mass, "hover_throttle": throttle, "thrust_to_weight": most / (mass * gravity)}
        if name in found and (limits := limits_of(fleet, scenario.spec)) is not None:
            held = [each.airspeed.min() for each in (limits.own, limits.lets) if each is not None]
            found[name]["wind_held_m_s"] = float(min(held))
        if any(sensor.type in MAGNETOMETERS for sensor in fleet.sensors.values()):
            found.setdefault(name, {}).update(_earth_field(scenario))
    return found


def _level_flight(vehicle: FixedWing) -> dict[str, float]:
    """Return what straight level flight at the cruise airspeed takes, of the first where aeroplanes differ."""
    alpha, elevator, throttle = cruise(vehicle, np.asarray(vehicle.cruise_airspeed))  # type: ignore[arg-type]
    each: dict[str, Any] = {
        "stall_speed_m_s": stall_speed(vehicle), "cruise_throttle": throttle, "cruise_angle_of_attack_rad": alpha,
        "cruise_elevator_rad": elevator,
    }  # fmt: skip
    return {key: float(np.ravel(value)[0]) for key, value in each.items()}


def _earth_field(scenario: Scenario) -> dict[str, float]:
    """Return what a compass at the site has to do with."""
    field = scenario.earth_field_ned
    return {
        "earth_field_uT": float(np.linalg.norm(field)),
        "declination_deg": math.degrees(declination(field)),
        "inclination_deg": math.degrees(inclination(field)),
    }
