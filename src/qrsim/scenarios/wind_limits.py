"""What wind the vehicles of a scenario hold, and warnings of one that is stronger."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.errors import UsageError
from qrsim.models.atmosphere.wind import FEET_PER_METRE, REFERENCE_FT, ROUGHNESS_M
from qrsim.models.vehicles.contracts import handling_of
from qrsim.models.vehicles.envelope import Envelope, envelope
from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.scenarios.build import vehicle_of, wind_of
from qrsim.scenarios.registry import is_outside
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.weather import largest_speed
from qrsim.scenarios.wind_schema import PROFILE

# Of a controller that names no voltage [V].
FULL_V = 12.0
# Gusts count twice their sigma against what a vehicle can do, and once against what a cascade lets it do. The published
# loops stay near a place only up to what their lean holds; a mean wind this much above it carries the vehicle away.
GUST_SIGMAS, BLOWN_AWAY = 2.0, 4.0 / 3.0


@dataclass(frozen=True)
class Limits:
    """What the vehicles (n,) of a fleet hold, and the wind where they are to fly.

    Attributes:
        own: by the vehicle alone.
        lets: as far as the controller lets it lean; None: it has no limit of its own.
        commanded: that limit as the scenario has it [rad].
        volts: voltage of the full battery [V], NaN where the thrust does not depend on it.
        heights: the highest place of each route [m].
        mean, sigma: wind there, and standard deviation of its gusts [m/s].
    """

    own: Envelope
    lets: Envelope | None
    commanded: Floats
    volts: Floats
    heights: Floats
    mean: Floats
    sigma: Floats

    @property
    def too_heavy(self) -> bool:
        """Whether a vehicle of the fleet cannot lift itself."""
        return bool((self.own.by_thrust & (self.own.tilt == 0.0)).any())


def voltages(fleet: FleetSpec) -> NumpyArray:
    """Return the voltage [V] of each vehicle's full battery, (n,)."""
    own = vars(fleet.controller).get("battery", FULL_V)
    if fleet.battery.type == "lithium_polymer":
        own = fleet.battery.voltage_full
    return np.broadcast_to(np.asarray(own, np.float64), (len(fleet.vehicles),))


def limits_of(fleet: FleetSpec, scenario: ScenarioSpec) -> Limits | None:
    """Return the winds that a fleet's vehicles can fly against; None for vehicles without tilt or flight envelope."""
    size = len(fleet.vehicles)
    try:
        vehicle = vehicle_of(fleet, scenario)
        handling = handling_of(vehicle)
    except UsageError:
        return None
    if handling is None or not np.all(np.asarray(handling.gravity) > 0.0):
        return None
    volts, most = np.full(size, math.nan), None
    if isinstance(vehicle, Quadrotor):
        volts = voltages(fleet)
        full = sum(np.asarray(part, np.float64) for part in handling.throttle_curve)
        most = np.minimum(full, vehicle.cvb0 + vehicle.cvb1 * volts)
    farthest = np.broadcast_to(np.asarray(handling.tilt_gain * handling.tilt_max, np.float64), (size,))
    own = envelope(vehicle, np.minimum(farthest, 1.4), most)
    commanded = vars(fleet.controller).get("tilt_limit")
    lets = None
    if commanded is not None:
        commanded = np.broadcast_to(np.asarray(commanded, np.float64), (size,))
        gain = 1.0 if fleet.controller.type == "cascade" else np.asarray(handling.tilt_gain, np.float64)
        lets = envelope(vehicle, np.minimum(gain * commanded, np.minimum(farthest, 1.4)), most)
    points = [[each.position_ned, *each.places_ned.values()] for each in fleet.vehicles]
    heights = np.array([max(-point[2] for point in own_points) for own_points in points])
    if own is None:
        return None
    mean, sigma = mean_wind(scenario, heights), gust_sigma(scenario, heights)
    return Limits(own, lets, np.asarray(commanded, np.float64), volts, heights, mean, sigma)


def wind_warnings(path: str, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield a warning if the wind at the highest place of a route exceeds the airspeed that a vehicle can hold."""
    if not _blows(scenario) or is_outside("vehicle", fleet.vehicle.type):
        return
    limits = limits_of(fleet, scenario)
    if limits is None or limits.too_heavy:
        return
    mean, gusts = limits.mean, GUST_SIGMAS * limits.sigma
    cases = [(mean + gusts, limits.own.airspeed, limits.own, _by_itself)]
    if limits.lets is not None and fleet.controller.type == "cascade":
        cases.append((mean + limits.sigma, limits.lets.airspeed, limits.lets, _as_let))
    elif limits.lets is not None:
        cases.append((mean, BLOWN_AWAY * limits.lets.airspeed, limits.lets, _as_let))
    for speed, limit, held, words in cases:
        if (speed > limit).any():
            i = int(np.argmax(speed - limit))
            fast = _speed(held, i)
            with_gusts = f" and gusts of {gusts[i]:.3g} m/s" if gusts[i] else ""
            yield (
                f"world.wind: {mean[i]:.3g} m/s{with_gusts} at {limits.heights[i]:g} m, where {path}.vehicles.{i} is "
                f"to fly; {words(limits, held, i)}, it holds an airspeed of {fast} and is carried away beyond"
            )
            return
    yield from _short_of_waypoints(path, fleet, scenario)


def _short_of_waypoints(path: str, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield a warning if the wind keeps vehicles from reaching the waypoints of their routes.

    The published waypoint loops lean by a constant times the distance to the waypoint and have no integral: in a steady
    wind they stand where that lean holds against it.
    """
    if (fleet.controller.type, fleet.guidance.type) != ("waypoint", "route") or fleet.guidance.repeat:
        return
    vehicle = vehicle_of(fleet, scenario)
    handling = handling_of(vehicle)
    if handling is None:
        return
    size, loops = len(fleet.vehicles), vars(fleet.controller)
    radius = np.broadcast_to(np.asarray(fleet.guidance.acceptance_radius, np.float64), (size,))
    asked = np.minimum(np.asarray(loops["position_gain"]) * radius, np.asarray(loops["speed_limit"]))
    held = envelope(vehicle, np.asarray(handling.tilt_gain * loops["velocity_gain"] * asked))
    if held is None:
        return
    heights = np.array([max((-place[2] for place in each.places_ned.values()), default=0.0) for each in fleet.vehicles])
    wind = mean_wind(scenario, heights)
    routes = np.array([len(each.waypoints_ned) > 0 for each in fleet.vehicles])
    over = np.where(routes, wind - held.airspeed, -np.inf)
    i = int(np.argmax(over))
    if over[i] > 0.0:
        yield (
            f"world.wind: {wind[i]:.3g} m/s at {heights[i]:g} m, where {path}.vehicles.{i} is to fly; above "
            f"{held.airspeed[i]:.3g} m/s the controller 'waypoint' rests farther than guidance.acceptance_radius, "
            f"{radius[i]:g} m, from a waypoint and may never reach it; use 'cascade' or a larger radius"
        )


def envelope_lines(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield a line of text for each flying fleet: its largest steady airspeed, and the wind along its route."""
    for name, fleet in scenario.fleets.items():
        limits = limits_of(fleet, scenario)
        if limits is None:
            continue
        i = int(np.argmin(limits.own.airspeed - limits.mean))
        own, lets = limits.own, limits.lets
        parts = [f"{_speed(own, i)} {_by_itself(limits, own, i)}"]
        if lets is not None and lets.airspeed[i] < own.airspeed[i]:
            parts.insert(0, f"{_speed(lets, i)} {_as_let(limits, lets, i)}")
        wind = f"the wind at {limits.heights[i]:g} m is {limits.mean[i]:.3g} m/s"
        gusts = f" with gusts of {limits.sigma[i]:.3g} m/s (std)" if limits.sigma[i] else ""
        yield f"fleets.{name}: holds a steady airspeed of {', '.join(parts)}; {wind}{gusts}"


def _speed(held: Envelope, i: int) -> str:
    """Return the largest steady airspeed of vehicle i as text with unit."""
    return f"{held.airspeed[i]:.3g} m/s"


def _by_itself(limits: Limits, held: Envelope, i: int) -> str:
    """Return as text what limits vehicle i's airspeed: its maximum tilt, or its maximum thrust."""
    if not held.by_thrust[i]:
        return f"leaning as far as it can, {held.tilt[i]:.3g} rad ({math.degrees(held.tilt[i]):.0f} deg)"
    volts = f" at {limits.volts[i]:g} V" if math.isfinite(limits.volts[i]) else ""
    return f"with all its thrust, {held.thrust[i]:.3g} N{volts}, leaning {math.degrees(held.tilt[i]):.0f} deg"


def _as_let(limits: Limits, held: Envelope, i: int) -> str:
    """Return as text that vehicle i tilts up to its controller's limit."""
    return f"leaning as far as its controller lets it, {limits.commanded[i]:g} rad"


def _blows(scenario: ScenarioSpec) -> bool:
    """Return whether a scenario has any wind or turbulence."""
    return scenario.world.wind.type != "calm" or scenario.world.turbulence.type != "still"


def mean_wind(scenario: ScenarioSpec, heights: NumpyArray) -> NumpyArray:
    """Return the speed of the mean wind [m/s] at heights (n,) [m]; the largest of a recorded wind."""
    wind = scenario.world.wind
    if is_outside("wind", wind.type):
        return np.zeros(len(heights))
    if wind.type in ("series", "grid", PROFILE):
        try:
            if wind.type == PROFILE:
                return largest_speed(scenario, heights)
            return wind_of(scenario).largest_speed(heights)
        except UsageError:
            return np.zeros(len(heights))
    speed = vars(wind).get("speed_20ft", 0.0)
    feet = np.maximum(heights, 0.0) * FEET_PER_METRE
    if vars(wind).get("profile", "log") == "power":
        return speed * (feet / REFERENCE_FT) ** wind.exponent
    roughness_ft = vars(wind).get("roughness", ROUGHNESS_M) * FEET_PER_METRE
    return speed * np.log(np.maximum(feet / roughness_ft, 1.0)) / math.log(REFERENCE_FT / roughness_ft)


def gust_sigma(scenario: ScenarioSpec, heights: NumpyArray) -> NumpyArray:
    """Return the standard deviation [m/s] of the horizontal gusts at heights (n,) [m] (MIL-F-8785C, low altitude)."""
    turbulence = scenario.world.turbulence
    if is_outside("turbulence", turbulence.type):
        return np.zeros(len(heights))
    speed = vars(turbulence).get("speed_20ft", 0.0)
    if speed is None:
        speed = vars(scenario.world.wind).get("speed_20ft", 0.0)
    feet = np.clip(heights * FEET_PER_METRE, 10.0, 1000.0)
    return 0.1 * speed / (0.177 + 0.000823 * feet) ** 0.4
