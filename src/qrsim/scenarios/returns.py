"""Checks of what the methods of a component return: shapes, types, records; values are those of a trace."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from qrsim.core.tree import field_info
from qrsim.core.vectors import Vec3
from qrsim.errors import did_you_mean
from qrsim.models.scene.area import REASONS
from qrsim.models.vehicles.contracts import Load, Pose
from qrsim.scenarios.value_checks import (
    array_problems,
    number_problems,
    pair_problems,
    pose_problems,
    record_problems,
    unchanged,
    value_text,
    vector_problems,
)
from qrsim.tasks.agents import Axis
from qrsim.world.state import Piloted, Saying, Some, Start, World

RETURNED = "it returned"
# Takes the component, the arguments and the result of a method.
Check = Callable[[Any, tuple[Any, ...], Any], Iterator[str]]


def _shape_in(args: tuple[object, ...]) -> tuple[int, ...] | None:
    """Return the shape (n,) of the first array with one number per vehicle among a method's arguments."""
    shapes = (tuple(np.shape(leaf)) for leaf in jax.tree.leaves(args))
    return next((shape for shape in shapes if len(shape) == 1), None)


def _own(self: Any) -> tuple[int, ...]:
    """Return the shape (n,) of arrays for the component's fleet; () for a component of the world."""
    return () if self._size is None else (self._size,)


def _check_reading(self: Any, args: object, result: Any) -> Iterator[str]:
    """Yield errors of a sensor's ``init``, which returns (state, reading), a reading a record with units."""
    yield from pair_problems(result, "the new state and the reading")
    yield from record_problems("the reading", result[1], _own(self))
    for field in dataclasses.fields(result[1]):
        if not field_info(field).unit:
            name = f"{type(result[1]).__name__}.{field.name}"
            yield f"{name} has no unit; expected {field.name}: ... = qrsim.quantity(unit=..., doc=...)"


def _check_next_reading(self: object, args: Any, result: Any) -> Iterator[str]:
    """Yield errors of a sensor's ``step``: those of ``init``, and a state that changes its structure."""
    yield from _check_reading(self, args, result)
    yield from unchanged("the state", args[0], result[0])


def _same_shape_as(check: Callable[[str, Any, tuple[int, ...]], Iterator[str]], position: int) -> Check:
    """Return a check that a method's result has the shape of its argument number ``position``."""

    def checked(self: object, args: Any, result: object) -> Iterator[str]:
        """Yield the errors of ``check`` for the shape (n,) of that argument."""
        shape = _shape_in(args[position : position + 1])
        if shape is not None:
            yield from check("the result", result, shape)

    return checked


def _check_state(self: object, args: Any, result: Any) -> Iterator[str]:
    """Yield errors of a result that replaces the state, the method's first argument."""
    yield from unchanged("the state", args[0], result)


def _check_command(self: Any, args: object, result: Any) -> Iterator[str]:
    """Yield errors of a controller's ``step``, which returns (state, command)."""
    yield from _check_state_and(self, "the command", args, result)
    yield from record_problems("the command", result[1], _own(self))


def _check_setpoint(self: object, args: object, result: object) -> Iterator[str]:
    """Yield errors of a guidance's ``step``, which returns (state, set-point)."""
    yield from _check_state_and(self, "the set-point", args, result)


def _check_state_and(self: Any, what: str, args: Any, result: Any) -> Iterator[str]:
    """Yield errors of a result (state, ``what``), and of a second part not of the type that the class gives."""
    yield from pair_problems(result, f"the new state and {what}")
    yield from unchanged("the state", args[0], result[0])
    gives = getattr(type(self), "gives", None)
    if gives is not None and not isinstance(result[1], gives):
        yield f"{what} is {value_text(result[1])}; expected {gives.__name__}, which '{type(self).__name__}.gives' names"


def _check_idle_command(self: object, args: object, result: object) -> Iterator[str]:
    """Yield errors of an idle command that is not of the component's type of command."""
    own = getattr(type(self), "command_type", object)
    if not isinstance(result, own):
        yield f"the command is {value_text(result)}; expected {own.__name__}, the command_type of {type(self).__name__}"
    yield from record_problems("the command", result, _own(self))


def _check_vehicle_step(self: Any, args: Any, result: Any) -> Iterator[str]:
    """Yield errors of a vehicle's ``step``, which returns (state, specific force)."""
    yield from pair_problems(result, "the new state and the specific force")
    yield from unchanged("the state", args[0], result[0])
    yield from vector_problems("the specific force", result[1], _own(self))


def _check_vehicle_state(self: object, args: object, result: object) -> Iterator[str]:
    """Yield errors of a vehicle's initial state, a record with a position."""
    if isinstance(result, Pose):
        yield from pose_problems("the state", result, _own(self))
    yield from record_problems("the state", result, _own(self))
    if not isinstance(getattr(result, "position_ned", None), Vec3):
        yield "the state has no position_ned, a qrsim.Vec3"


def _check_pose(self: object, args: object, result: object) -> Iterator[str]:
    """Yield errors of a vehicle's pose, a ``Pose`` of arrays (n,)."""
    if not isinstance(result, Pose):
        yield f"it returned {value_text(result)}; expected a Pose (qrsim.models.vehicles.contracts)"
    yield from pose_problems("the pose", result, _own(self))


def _check_load(self: Any, args: object, result: Any) -> Iterator[str]:
    """Yield errors of a vehicle's load: thrust, weight and power, each (n,) or one number."""
    if not isinstance(result, Load):
        yield f"it returned {value_text(result)}; expected a Load (qrsim.models.vehicles.contracts)"
    yield from number_problems("the load.thrust", result.thrust, _own(self))
    yield from number_problems("the load.weight", result.weight, _own(self))
    if result.power is not None:
        yield from number_problems("the load.power", result.power, _own(self))


def _check_specific_force(self: object, args: object, result: object) -> Iterator[str]:
    """Yield errors of a vehicle's specific force, a ``Vec3`` of arrays (n,)."""
    yield from vector_problems("the specific force", result, _own(self))


def _check_battery_state(self: Any, args: object, result: Any) -> Iterator[str]:
    """Yield errors of the initial state of a battery, which has a charge if it drains."""
    if self.drains and not hasattr(result, "charge"):
        yield f"the state is {value_text(result)}; expected a record with the field charge, since drains is True"
    elif self.drains:
        yield from array_problems("the state.charge", result.charge, _own(self))


def _check_voltage(self: object, args: Any, result: object) -> Iterator[str]:
    """Yield errors of a battery's voltage; None is allowed only if the battery has a state."""
    if result is not None:
        yield from array_problems("the voltage", result, _own(self))
    elif args[0] is None:
        yield (
            f"it returned None, and so did init; expected a voltage, an array of shape {_own(self)}, or a state (a "
            "battery without either is the type 'given')"
        )


def _check_area_checks(self: object, args: Any, result: object) -> Iterator[str]:
    """Yield errors of an area's ``check``, a list of (reason code, value (n,), broken (n,) bool)."""
    shape = _shape_in(args[:1])
    assert shape is not None
    if not isinstance(result, list | tuple):
        yield f"it returned {value_text(result)}; expected a list of (code, value, broken)"
        return
    for number, check in enumerate(result):
        if not isinstance(check, tuple) or len(check) != 3:
            yield f"check {number} is {value_text(check)}; expected (code, value, broken)"
            return
        code, value, broken = check
        if not isinstance(code, int) or not 0 < code < len(REASONS):
            yield f"the code of check {number} is {code!r:.60}; expected reason_code(...) of qrsim.models.scene.area"
        yield from array_problems(f"the value of check {number}", value, shape)
        if getattr(broken, "shape", None) != shape or broken.dtype != bool:
            yield f"broken of check {number} is {value_text(broken)}; expected an array of bool of shape {shape}"


def _check_placement(self: Any, args: object, result: Any) -> Iterator[str]:
    """Yield errors of a placement's result: the vehicles' start, and whether places were found."""
    yield from pair_problems(result, "the start and whether a place was found")
    if not isinstance(result[0], Start):
        yield f"the start is {value_text(result[0])}; expected the Start that it was handed, by qrsim.core.tree.replace"
    yield from pose_problems("the start", result[0], _own(self))
    if getattr(result[1], "shape", None) != () or result[1].dtype != bool:
        yield f"whether a place was found is {value_text(result[1])}; expected one bool"


def _check_reward(self: Any, args: Any, result: Any) -> Iterator[str]:
    """Yield errors of a task's ``judge``, which returns (memory, reward (n,))."""
    yield from pair_problems(result, "the new memory and the reward")
    yield from unchanged("the memory", args[0], result[0])
    yield from _for_each_fleet(
        self, args[1], "the reward", result[1], lambda what, n, part: array_problems(what, part, (n,))
    )


def _for_each_fleet(
    task: Any, world: World, what: str, result: Any, check: Callable[[str, int, Any], Iterator[str]]
) -> Iterator[str]:
    """Yield the errors that ``check(what, agents, value)`` finds in each agents' fleet of a task's result."""
    sizes = {fleet.name: fleet.size for fleet in world.fleets}
    for fleet in task.fleets:
        if fleet not in sizes:
            yield f"{type(task).__name__}.fleets names '{fleet}'{did_you_mean(fleet, sizes)}; no fleet is called so"
            return
    if len(task.fleets) == 1:
        yield from check(what, sizes[task.fleet], result)
        return
    if not isinstance(result, dict) or set(result) != set(task.fleets):
        found = (
            f"a dict of {', '.join(map(str, result)) or 'nothing'}" if isinstance(result, dict) else value_text(result)
        )
        yield f"{what} is {found}; expected a dict with one for each fleet of agents: {', '.join(task.fleets)}"
        return
    for fleet in task.fleets:
        yield from check(f"{what} of fleet '{fleet}'", sizes[fleet], result[fleet])


def _check_observation(whole: str, n: int, result: object) -> Iterator[str]:
    """Yield errors of an observation ``whole``, an array (n, O) or a dict of arrays (n, ...) by name."""
    parts = result if isinstance(result, dict) else {"": result}
    for name, part in parts.items():
        what = f"{whole}{f' {name!r}' if name else ''}"
        found = tuple(np.shape(part)) if hasattr(part, "shape") else None
        if found is None:
            is_now = value_text(part)
            yield f"{what} is {is_now}; expected an array whose first axis has {n} entries, one for each vehicle"
        elif found[:1] != (n,) or (not name and len(found) != 2):
            yield f"{what} has shape {found}; expected ({n}, O), a row for each vehicle"


def _check_axis_names(self: Any, args: Any, result: Any) -> Iterator[str]:
    """Yield errors of a task's ``sees``: an ``Axis`` for each observed number, of each fleet of agents."""
    yield from _for_each_fleet(self, args[0], RETURNED, result, _check_axes)


def _check_axes(what: str, n: int, result: object) -> Iterator[str]:
    """Yield errors of the names of observed numbers, a tuple of ``Axis`` or a dict of them."""
    verb = "" if what == RETURNED else " is"
    for axes in result.values() if isinstance(result, dict) else (result,):
        if not isinstance(axes, tuple | list) or not all(isinstance(axis, Axis) for axis in axes):
            yield f"{what}{verb} {value_text(axes)}; expected a tuple of Axis (qrsim.tasks.agents), one for each number"


def _check_observation_names(self: Any, args: Any, result: Any) -> Iterator[str]:
    """Yield errors of a task's ``observe``: arrays with a row per agent, and as many numbers as ``sees`` names."""
    names = self.sees(args[1])

    def agreed(what: str, n: int, part: Any) -> Iterator[str]:
        """Yield the errors of one fleet's observation, compared with the names for that fleet."""
        fleet = next((name for name in self.fleets if part is result.get(name)), "") if len(self.fleets) > 1 else ""
        yield from _check_observation(what, n, part)
        yield from _check_names_match(self, what, part, names[fleet] if fleet else names)

    yield from _for_each_fleet(self, args[1], "the observation", result, agreed)


def _check_names_match(self: Any, whole: str, result: Any, names: Any) -> Iterator[str]:
    """Yield the differences between an observation and the names that the task's ``sees`` gives."""
    if isinstance(names, dict) != isinstance(result, dict):
        yield f"{whole} is {value_text(result)}, but {type(self).__name__}.sees returns {value_text(names)}"
    for name, axes in names.items() if isinstance(result, dict) else (("", names),):
        what = f"{whole}{f' {name!r}' if name else ''}"
        if name and name not in result:
            yield f"{what} is not there, but {type(self).__name__}.sees names it"
            return
        count = math.prod((result[name] if name else result).shape[1:])
        if len(axes) != count:
            yield f"{what} has {count} numbers, but {type(self).__name__}.sees names {len(axes)}; expected as many"


def _check_actions(self: object, args: Any, result: object) -> Iterator[str]:
    """Yield errors of a task's ``commands``, a tuple with an action or None for each fleet."""
    fleets = args[1].fleets
    if not isinstance(result, tuple) or len(result) != len(fleets):
        yield f"it returned {value_text(result)}; expected a tuple of {len(fleets)}, one action or None for each fleet"
        return
    for fleet, action in zip(fleets, result, strict=True):
        for part in _commands_in(action):
            yield from _check_action(fleet, part)


def _commands_in(action: object) -> list[object]:
    """Return the commands and set-points in one fleet's action."""
    if isinstance(action, Saying):
        return _commands_in(action.action)
    if isinstance(action, Some):
        return [part for _, part in action.parts]
    return [] if action is None or isinstance(action, Piloted) else [action]


def _check_action(fleet: Any, action: Any) -> Iterator[str]:
    """Yield errors of a command or set-point that the fleet does not accept, or of a wrong shape."""
    what = f"the action of fleet '{fleet.name}'"
    taken = (*getattr(type(fleet.controller), "setpoints", ()), *fleet.vehicle.actions)
    if not isinstance(action, taken):
        names = ", ".join(dict.fromkeys(each.__name__ for each in taken))
        yield f"{what} is {value_text(action)}; expected a kind that its controller and vehicles take: {names}; or None"
        return
    for path, leaf in jax.tree_util.tree_leaves_with_path(action):
        name = f"{type(action).__name__}{jax.tree_util.keystr(path)}"
        if np.shape(leaf) not in ((), (fleet.size,)):
            yield f"{what}: {name} has shape {np.shape(leaf)}; expected ({fleet.size},), one number for each vehicle"


CHECKS: dict[tuple[str, str], Check] = {
    ("sensor", "init"): _check_reading,
    ("sensor", "step"): _check_next_reading,
    ("wind", "velocity_ned"): _same_shape_as(vector_problems, 0),
    ("gust", "velocity_ned"): _same_shape_as(vector_problems, 0),
    ("updraft", "velocity_ned"): _same_shape_as(vector_problems, 0),
    ("turbulence", "step"): _check_state,
    ("turbulence", "gust_ned"): _same_shape_as(vector_problems, 1),
    ("turbulence", "gust_rates_ned"): _same_shape_as(vector_problems, 1),
    ("vehicle", "initial_state"): _check_vehicle_state,
    ("vehicle", "pose"): _check_pose,
    ("vehicle", "idle_command"): _check_idle_command,
    ("vehicle", "load"): _check_load,
    ("vehicle", "specific_force"): _check_specific_force,
    ("vehicle", "step"): _check_vehicle_step,
    ("vehicle", "stopped"): _check_state,
    ("battery", "init"): _check_battery_state,
    ("battery", "step"): _check_state,
    ("battery", "voltage"): _check_voltage,
    ("controller", "idle_command"): _check_idle_command,
    ("controller", "step"): _check_command,
    ("guidance", "step"): _check_setpoint,
    ("area", "check"): _check_area_checks,
    ("area", "margin"): _same_shape_as(array_problems, 0),
    ("area", "height_agl"): _same_shape_as(array_problems, 0),
    ("ground", "down"): _same_shape_as(array_problems, 0),
    ("ground", "normal"): _same_shape_as(vector_problems, 0),
    ("sky", "step"): _check_state,
    ("placement", "place"): _check_placement,
    ("task", "judge"): _check_reward,
    ("task", "observe"): _check_observation_names,
    ("task", "sees"): _check_axis_names,
    ("task", "commands"): _check_actions,
}
