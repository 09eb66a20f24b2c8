"""What follows from the parameters of the vehicles of a scenario, for people: hover, reserves, the wind they hold."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jax import Array

from qrsim.core.host import on_host
from qrsim.core.tree import map_tree
from qrsim.core.vectors import Euler, Vec3
from qrsim.files import Content
from qrsim.models.sensors.earth_field import declination, inclination
from qrsim.models.vehicles.contracts import Battery, Load, Vehicle, handling_of
from qrsim.models.vehicles.fixed_wing import FixedWing
from qrsim.models.vehicles.fixed_wing.trim import cruise, stall_speed
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.models.vehicles.multirotor.derived import derived
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.build import vehicle_of
from qrsim.scenarios.components import component
from qrsim.scenarios.scenario import Scenario
from qrsim.scenarios.sites import MAGNETOMETERS
from qrsim.scenarios.wind_limits import limits_of

# A battery is drained in steps of this length [s], and no longer than that.
DRAIN_STEP_S, MOST_ENDURANCE_S = 5.0, 86_400.0


def derived_of(scenario: Scenario) -> dict[str, dict[str, float]]:
    """Return fleet -> quantity -> value, such as hover throttle and endurance; quantities' names end with units."""
    found = {}
    for name, fleet in scenario.spec.fleets.items():
        vehicle = vehicle_of(fleet, scenario.spec)
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
        on_battery = _hover_on_battery(vehicle, component(fleet.battery, known.BATTERIES, scenario.spec))
        if on_battery:
            found.setdefault(name, {}).update(on_battery)
        if any(sensor.type in MAGNETOMETERS for sensor in fleet.sensors.values()):
            found.setdefault(name, {}).update(_earth_field(scenario))
    return found


def heights_line(scenario: Scenario) -> str:
    """Return a line of text with the site's heights above ellipsoid and sea, and the geoid's height."""
    site = scenario.spec.site
    geoid = site.undulation
    name = "EGM96" if site.geoid is None else site.geoid.source or "given"
    # Zero has no sign.
    ellipsoid, amsl = (round(height, 2) + 0.0 for height in (site.height, site.height - geoid))
    return (
        f"site: {ellipsoid:.2f} m above the WGS-84 ellipsoid, {amsl:.2f} m above mean sea level; undulation of the "
        f"geoid ({name}): {geoid:.2f} m"
    )


def _level_flight(vehicle: FixedWing) -> dict[str, float]:
    """Return throttle, angle of attack and elevator in level cruise, and stall speed, of a fleet's first vehicle."""
    alpha, elevator, throttle = cruise(vehicle, np.asarray(vehicle.cruise_airspeed))  # type: ignore[arg-type]
    each: Content = {
        "stall_speed_m_s": stall_speed(vehicle),
        "cruise_throttle": throttle,
        "cruise_angle_of_attack_rad": alpha,
        "cruise_elevator_rad": elevator,
    }
    return {key: float(np.ravel(value)[0]) for key, value in each.items()}


def _first(leaf: Any) -> Any:
    """Return the first element of an array as float32: the parameter of a fleet's first vehicle."""
    return np.float32(np.ravel(leaf)[0])


def _hover_on_battery(vehicle: Vehicle, battery: Battery) -> dict[str, float]:
    """Return power, current and endurance of the first vehicle in a hover at the height of the site."""
    if not battery.drains or handling_of(vehicle) is None:
        return {}
    vehicle, battery = map_tree(_first, vehicle), map_tree(_first, battery)
    zero = np.zeros(1, np.float32)

    def hover(vehicle: Vehicle, battery: Battery, zero: Array) -> tuple[Load, object, Array | None]:
        """Return load, battery state and voltage of a vehicle that hovers in still air; ``zero`` is (1,)."""
        still = Vec3(zero, zero, zero)
        load = vehicle.load(vehicle.initial_state(still, Euler(zero, zero, zero), still, still))
        state = battery.init(zero)
        return load, state, battery.voltage(state, load)

    load, state, voltage = on_host(hover)(vehicle, battery, zero)
    drain = on_host(lambda battery, state, load: battery.step(state, load, DRAIN_STEP_S))
    charges = [float(state.charge[0])]
    while charges[-1] > 0.0 and len(charges) * DRAIN_STEP_S < MOST_ENDURANCE_S:
        state = drain(battery, state, load)
        charges.append(float(state.charge[0]))
    # The last step ends below empty: up to there it goes on as in the step before.
    whole = len(charges) - 2
    rest = charges[-2] / (charges[-3] - charges[-2]) if whole and charges[-1] <= 0.0 else 1.0
    found = {"hover_endurance_s": (whole + rest) * DRAIN_STEP_S}
    if battery.capacity is not None:
        found["hover_current_A"] = (charges[0] - charges[1]) * float(battery.capacity) * 3600.0 / DRAIN_STEP_S
        found["hover_power_W"] = found["hover_current_A"] * float(voltage[0])
    return found


def _earth_field(scenario: Scenario) -> dict[str, float]:
    """Return strength, declination and inclination of the Earth's magnetic field at the site."""
    field = scenario.earth_field_ned
    return {
        "earth_field_uT": float(np.linalg.norm(field)),
        "declination_deg": math.degrees(declination(field)),
        "inclination_deg": math.degrees(inclination(field)),
    }
