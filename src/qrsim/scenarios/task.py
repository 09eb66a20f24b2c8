"""Checks of a task against its world."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from qrsim.errors import did_you_mean
from qrsim.models.vehicles.commands import fields_of
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.build import build_task
from qrsim.scenarios.registry import is_outside
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.timing import is_multiple
from qrsim.tasks.direct import GYROSCOPES, accepts
from qrsim.tasks.formation import BEACON
from qrsim.tasks.perceived import SEEING
from qrsim.tasks.simple import is_direct

# Sensors by the field of a task that names one.
SENSORS = {"camera": ("camera", "ideal_camera"), "sensor": ("concentration", "ideal_concentration")}
# What the vehicles of tasks are commanded that ask for no set-point.
COMMANDED = ("pitch", "roll", "throttle", "yaw_rate")
# What has to be in the world.
CONTENTS = {"search": "persons", "plume_mapping": "plume"}


def task_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of a task in its scenario: unknown fleets, wrong period, missing contents or sensors."""
    task = scenario.task
    if task.type == "none":
        return
    for name in ("fleet", "prey", "leader"):
        wanted = vars(task).get(name)
        if wanted is not None and wanted not in scenario.fleets:
            yield f"task.{name}: no fleet is called '{wanted}'{did_you_mean(wanted, scenario.fleets)}"
    if not is_multiple(task.period, scenario.time_step):
        yield f"task.period: {task.period:g} s is not a multiple of the time step {scenario.time_step:g} s"
    elif not is_multiple(scenario.duration, task.period):
        yield f"task.period: the duration, {scenario.duration:g} s, is not a multiple of it, {task.period:g} s"
    if task.type == "keep_formation":
        yield from _formation_problems(scenario)
    content = CONTENTS.get(task.type)
    if content and getattr(scenario.world, content).type == "none":
        yield f"world.{content}: there is none, and the task '{task.type}' is about it"
    if task.type == "plume_mapping" and task.anywhere > task.locations:
        yield f"task.anywhere: {task.anywhere}; allowed: at most locations, {task.locations}"
    if task.fleet not in scenario.fleets:
        return
    built = build_task(scenario, "float32")
    for name in built.fleets:
        if name in scenario.fleets:
            yield from _setpoint_problems(scenario, name, built.asks(name))
        else:
            yield f"task.fleets: no fleet is called '{name}'{did_you_mean(name, scenario.fleets)}"
    if is_direct(built):
        yield from _action_problems(task, scenario.fleets[task.fleet])
    yield from _fleet_problems(scenario, scenario.fleets[task.fleet])


def _formation_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the problems of a formation: a leader among its followers, or a radio that sends no positions."""
    task, radio = scenario.task, scenario.world.radio
    if task.leader == task.fleet:
        yield f"task.leader: '{task.leader}' is the fleet of the agents, task.fleet; name another one"
    if radio is None:
        yield f"world.radio: the task '{task.type}' needs one; give a preset, such as world.radio: sphere"
    elif not radio.beacon or radio.size < BEACON:
        yield f"task '{task.type}': it needs beacons; give world.radio beacon: true and a size of at least {BEACON}"
    for name in {task.leader, task.fleet} & set(scenario.fleets):
        own = scenario.fleets[name].radio
        if own is not None and not own.works:
            yield f"fleets.{name}.radio: none; the task '{task.type}' needs one"


def _action_problems(task: Any, fleet: FleetSpec) -> Iterator[str]:
    """Yield errors of actions below attitude: vehicles that do not accept them, or that measure no body rates."""
    actions, vehicle = task.actions, fleet.vehicle.type
    if not accepts(known.VEHICLES[vehicle]):
        allowed = ", ".join(sorted(name for name, cls in known.VEHICLES.items() if accepts(cls)))
        yield (
            f"task.actions: {actions}; only vehicles of type {allowed} accept them, and fleet '{task.fleet}' has type "
            f"'{vehicle}'"
        )
    if not any(issubclass(known.SENSORS[sensor.type], GYROSCOPES) for sensor in fleet.sensors.values()):
        types = ", ".join(name for name, cls in known.SENSORS.items() if issubclass(cls, GYROSCOPES))
        yield f"task.actions: {actions}; they need body rates, and fleet '{task.fleet}' has no sensor of type {types}"


def _senses_problems(task: Any, fleet: FleetSpec) -> Iterator[str]:
    """Yield the errors of the sensor names in a task's ``senses``, which agents observe."""
    names = vars(task).get("senses") or ()
    if is_outside("task", task.type):
        return
    allowed = sorted(name for name, cls in known.SENSORS.items() if issubclass(cls, SEEING))
    for number, name in enumerate(names):
        if name not in fleet.sensors:
            hint = did_you_mean(name, fleet.sensors)
            yield f"task.senses: no sensor of fleet '{task.fleet}' is called '{name}'{hint}"
        elif fleet.sensors[name].type not in allowed:
            found = fleet.sensors[name].type
            yield f"task.senses: '{name}' is a sensor of type '{found}'; allowed: {', '.join(allowed)}"
        elif name in names[:number]:
            yield f"task.senses: '{name}' is named twice"


def _setpoint_problems(scenario: ScenarioSpec, name: str, asks_for: type | None) -> Iterator[str]:
    """Yield an error if a fleet's controller does not accept ``asks_for``, the set-points of its task."""
    task, fleet = scenario.task, scenario.fleets[name]
    if asks_for is not None and asks_for not in known.CONTROLLERS[fleet.controller.type].setpoints:
        fitting = [name for name, cls in known.CONTROLLERS.items() if asks_for in cls.setpoints]
        yield (
            f"fleets.{name}.controller: '{fleet.controller.type}' does not take what the task '{task.type}' asks "
            f"for, {asks_for.__name__}; " + (f"allowed: {', '.join(fitting)}" if fitting else "no controller does")
        )
    fields = fields_of(known.VEHICLES[fleet.vehicle.type].command_type)
    if asks_for is None and not set(COMMANDED) <= set(fields) and not is_outside("task", task.type):
        yield (
            f"task.fleet: '{name}' has vehicles of type '{fleet.vehicle.type}', and the task '{task.type}' is "
            f"flown by their {', '.join(COMMANDED)}"
        )


def _fleet_problems(scenario: ScenarioSpec, fleet: FleetSpec) -> Iterator[str]:
    """Yield the sensors that a task needs and that its fleet lacks, or has of another type."""
    task = scenario.task
    yield from _senses_problems(task, fleet)
    for field, types in SENSORS.items():
        if field not in vars(task):
            continue
        name = getattr(task, field)
        if name not in fleet.sensors:
            hint = did_you_mean(name, fleet.sensors)
            yield f"task.{field}: no sensor of fleet '{task.fleet}' is called '{name}'{hint}"
        elif fleet.sensors[name].type not in types and not is_outside("task", task.type):
            found = fleet.sensors[name].type
            yield f"task.{field}: '{name}' is a sensor of type '{found}'; allowed: {', '.join(types)}"
