"""Checks of the geometry of a multirotor, of its thrust, and of where it stands."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.models.vehicles.multirotor.commands import MOST_ROTORS
from qrsim.models.vehicles.multirotor.geometry import rank_of
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.sites import air_of
from qrsim.scenarios.vehicle_checks import grams_hint

# Below this ratio of the weakest to the strongest of thrust and three torques a mixer has no authority.
LEAST_AUTHORITY = 0.02
# The rule of Runge and Kutta follows a lag that is at least this part of its step [1]; its bound is 1/2.785.
SHORTEST_LAG = 0.4
# A start so little below where it stands [m] is meant to be there.
ON_IT = 0.01


def multirotor_problems(name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the reasons why a fleet of multirotors cannot fly; nothing for other fleets."""
    if not issubclass(known.VEHICLES[fleet.vehicle.type], Multirotor):
        return
    path, wrong = f"fleets.{name}.vehicle", False
    for problem in _geometry(path, fleet):
        wrong = True
        yield problem
    if not wrong:
        yield from _lift(path, fleet, float(air_of(scenario).site_density))
        yield from _lags(path, fleet, scenario.time_step)
        yield from _standing(name, fleet, scenario)


def _geometry(path: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield the errors of a multirotor's rotors and feet: number, axes, spin directions, control authority."""
    rotors, feet = fleet.vehicle.rotors, fleet.vehicle.feet
    if not 4 <= len(rotors) <= MOST_ROTORS:
        yield f"{path}.rotors: {len(rotors) or 'no'} rotors; allowed: 4 to {MOST_ROTORS}"
        return
    if len(feet) < 3:
        yield f"{path}.feet: {len(feet) or 'no'} contact points to stand on; allowed: at least 3"
    for i, rotor in enumerate(rotors):
        length = math.hypot(*rotor.axis)
        if abs(length - 1.0) > 1e-3:
            yield f"{path}.rotors.{i}.axis: its length is {length:.4g}; expected a unit vector, as [0, 0, -1]"
        if rotor.direction not in (1, -1):
            yield f"{path}.rotors.{i}.direction: {rotor.direction}; allowed: 1 (clockwise seen from above) or -1"
    authority = rank_of(rotors, float(np.min(fleet.vehicle.torque_ratio)))
    if authority < LEAST_AUTHORITY:
        yield (
            f"{path}.rotors: the rotors cannot command thrust, roll, pitch and yaw by themselves: the weakest has "
            f"{round(authority, 9):.2g} of the authority of the strongest; allowed: at least {LEAST_AUTHORITY:g}"
        )


def thrust_to_weight(fleet: FleetSpec, scenario: ScenarioSpec) -> float | None:
    """Return a fleet's smallest ratio of maximum thrust to weight at the site; None for other vehicles."""
    if not issubclass(known.VEHICLES[fleet.vehicle.type], Multirotor):
        return None
    found = _thrust_and_weight(fleet, float(air_of(scenario).site_density))
    return None if found is None else float(np.min(found[0] / found[1]))


def _thrust_and_weight(fleet: FleetSpec, density: float) -> tuple[NumpyArray, NumpyArray] | None:
    """Return maximum thrust and weight [N], () or (n,), in air of ``density`` [kg/m^3]; None if list lengths differ."""
    spec = fleet.vehicle
    names = ("thrust_coefficient", "speed_max", "mass", "gravity", "air_density")
    each = [np.asarray(getattr(spec, key), float) for key in names]
    # Lists of the wrong length are a problem of their own.
    if len({part.size for part in each if part.ndim}) > 1:
        return None
    coefficient, speed, mass, gravity, own_density = each
    most = density / own_density * coefficient * speed**2 * -sum(rotor.axis[2] for rotor in spec.rotors)
    return most, mass * gravity


def _lift(path: str, fleet: FleetSpec, density: float) -> Iterator[str]:
    """Yield an error if a multirotor cannot lift itself in air of ``density`` [kg/m^3]."""
    spec = fleet.vehicle
    found = _thrust_and_weight(fleet, density)
    if found is None:
        return
    most, weight = found
    mass = np.asarray(spec.mass, float)
    own_density, most, weight = map(np.ravel, np.broadcast_arrays(spec.air_density, most, weight))
    i = int(np.argmin(most / weight))
    lift, heavy = float(most[i]), float(weight[i])
    if lift <= heavy:
        thin = density < 0.99 * float(own_density[i])
        yield (
            f"{path}: cannot hover: {len(spec.rotors)} rotors lift {lift:.4g} N at speed_max"
            + (f" in the air of the site, {density:.4g} kg/m^3" if thin else "")
            + f", and it weighs {heavy:.4g} N; lower mass{', or site.height' if thin else ''}, or raise "
            + f"thrust_coefficient or speed_max{grams_hint(float(np.max(mass)))}"
        )


def _lags(path: str, fleet: FleetSpec, time_step: float) -> Iterator[str]:
    """Yield an error for rotors with a lag too short for a substep, with which their speeds would oscillate."""
    longest = min(fleet.vehicle.longest_substep, time_step)
    for name in ("spin_up", "spin_down"):
        least = float(np.min(getattr(fleet.vehicle, name)))
        if least < SHORTEST_LAG * longest:
            yield (
                f"{path}.{name}: {least:g} s is too short for substeps of {longest:g} s; allowed: at least "
                f"{SHORTEST_LAG * longest:g}, or a longest_substep of at most {least / SHORTEST_LAG:g}"
            )


def _standing(name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error for each start at which a foot of the multirotor is below the ground."""
    if scenario.world.ground.type != "flat" or fleet.placement.type != "given":
        return
    high, ground = max(foot[2] for foot in fleet.vehicle.feet), -scenario.world.ground.height
    for i, vehicle in enumerate(fleet.vehicles):
        z = vehicle.position_ned[2]
        if ground + ON_IT >= z > ground - high + ON_IT:
            yield (
                f"fleets.{name}.vehicles.{i}.position_ned: z = {z:g} m is below where it stands on its feet; allowed: "
                f"at most {ground - high:g}; did you mean on_ground: true, which puts it there?"
            )
