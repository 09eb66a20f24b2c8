"""Checks and warnings of updrafts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from qrsim.core.host import on_host
from qrsim.errors import UsageError
from qrsim.scenarios.build import ground_if_any, updraft_of, wind_of
from qrsim.scenarios.schema import ScenarioSpec

# Of the nearest of more thermals every vehicle must know the distance of each.
MANY_THERMALS = 200


def updraft_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error for each updraft that does not fit the scenario's world."""
    ground = ground_if_any(scenario) if scenario.world.updrafts else None
    for i, updraft in enumerate(scenario.world.updrafts):
        path = f"world.updrafts.{i}"
        if updraft.type == "ridge_lift" and ground is not None and ground.flat:
            yield f"{path}: 'ridge_lift' needs ground with slopes; world.ground is 'flat'; use one of type dem"
            continue
        # The widest that an episode may draw.
        deepest = [{"z_i": item.high} for item in scenario.ranges if item.path == f"{path}.z_i"]
        for changes in ({}, *deepest):
            try:
                updraft_of(scenario, i, **changes)
            except UsageError as error:
                yield f"{path}.{error}" if ": " in str(error) else f"{path}: {error}"
                break


def updraft_warnings(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield a warning for each updraft that has no effect, or none where vehicles fly."""
    points = {
        f"fleets.{name}.vehicles.{i}": max(-place[2] for place in (vehicle.position_ned, *vehicle.places_ned.values()))
        for name, fleet in scenario.fleets.items()
        for i, vehicle in enumerate(fleet.vehicles)
    }
    for i, updraft in enumerate(scenario.world.updrafts):
        path = f"world.updrafts.{i}"
        if updraft.type == "thermals":
            above = [(where, height) for where, height in points.items() if height >= updraft.z_i]
            if above:
                where, height = above[0]
                yield f"{path}.z_i: {updraft.z_i:g} m, and {where} is at {height:g} m or sent there; no air rises there"
            number = updraft_of(scenario, i).number
            if number > MANY_THERMALS:
                yield f"{path}: {number} thermals, all computed for every vehicle in every tick; expect slow runs"
        elif updraft.type in ("ridge_lift", "building_wakes") and _is_calm(scenario):
            yield f"{path}: '{updraft.type}' does nothing without a wind; world.wind is calm"


_mean = on_host(lambda wind, height: wind.mean_velocity_ned(height))


def _is_calm(scenario: ScenarioSpec) -> bool:
    """Return whether the mean wind is zero at 20 m and 100 m."""
    mean = _mean(wind_of(scenario), np.array([20.0, 100.0], np.float32))
    return not (np.any(mean.x) or np.any(mean.y))
