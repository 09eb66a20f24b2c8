"""Pushes of a scenario, of its fleets' faults and of its world's events: checked and built."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from qrsim.core.tree import record_of
from qrsim.core.vectors import Vec3
from qrsim.errors import did_you_mean
from qrsim.models.vehicles.faults import Push
from qrsim.scenarios.fault_schema import PushSpec
from qrsim.scenarios.faults import is_pushable, mask_of, push_problems, tick_of, vehicle_names
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.timing import is_multiple


def pushes(fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> tuple[Push, ...]:
    """Build a fleet's external pushes: those among its faults, then those of ``world.events`` that affect it."""
    names, dt = vehicle_names(fleet_name, fleet), scenario.time_step
    found = [(spec.at, spec.end, spec) for spec in fleet.faults if isinstance(spec, PushSpec)]
    if is_pushable(fleet):
        events = [(event.at, event.push) for event in scenario.world.events if event.push is not None]
        concerned = [(at, push) for at, push in events if push.vehicles is None or set(names) & set(push.vehicles)]
        found += [(at, at + getattr(push, "for"), push) for at, push in concerned]
    return tuple(
        record_of(
            Push,
            tick_of(at, dt),
            tick_of(end, dt),
            mask_of(names, push.vehicles),
            _vector(push.acceleration_ned),
            _vector(push.acceleration_body),
        )
        for at, end, push in found
    )


def _vector(acceleration: list[float] | None) -> Vec3:
    """Convert an acceleration of three numbers [m/s^2], NED or body, to a vector; zero for None."""
    return record_of(Vec3, *(acceleration or (0.0, 0.0, 0.0)))


def push_event_problems(path: str, push: Any, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of a push in ``world.events`` of a scenario."""
    lasts, dt = getattr(push, "for"), scenario.time_step
    if not is_multiple(lasts, dt, math.inf):
        yield f"{path}.for: {lasts:g} s is not a multiple of the time step {dt:g} s"
    fleets = {name: set(vehicle_names(name, fleet)) for name, fleet in scenario.fleets.items()}
    everybody = set[str]().union(*fleets.values())
    for name in push.vehicles or ():
        if name not in everybody:
            yield f"{path}.vehicles: no vehicle is called '{name}'{did_you_mean(name, sorted(everybody))}"
    chosen = [name for name in fleets if push.vehicles is not None and fleets[name] & set(push.vehicles)]
    if push.vehicles is None:
        chosen = [name for name in fleets if is_pushable(scenario.fleets[name])] or [next(iter(fleets))]
    told = dict.fromkeys(
        line for name in chosen for line in push_problems(path, f"{path}.vehicles", push, scenario.fleets[name])
    )
    yield from told
