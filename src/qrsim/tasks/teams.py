"""Agents of one fleet or of several: who they are, and their numbers in one array or by fleet.

In an array (n, A) of actions the agents are those of all fleets in the order of ``Task.fleets``, and A is the largest
number of any agent's axes; what an agent has no axis for is 0 and not looked at.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.control.setpoints import library
from qrsim.errors import UsageError, did_you_mean
from qrsim.tasks.agents import Axis, number_of
from qrsim.tasks.contracts import Task
from qrsim.world.state import World


@dataclass(frozen=True)
class Side:
    """The agents of one fleet.

    Attributes:
        fleet: its name.
        names: of its vehicles.
        rows: where these are among all agents.
        axes: the numbers of an action of each.
    """

    fleet: str
    names: tuple[str, ...]
    rows: slice
    axes: tuple[Axis, ...]


def sides_of(task: Task, world: World) -> tuple[Side, ...]:
    """Return the agents of a task grouped by fleet, one ``Side`` per fleet.

    Raises:
        UsageError: a fleet is none, or is named twice, or a task of several fleets does not say what each of them does.
    """
    found: list[Side] = []
    first = 0
    acts: Any = task.acts(world)
    several = len(task.fleets) > 1
    for name in task.fleets:
        fleet = world.fleets[number_of(world, name)]
        if any(side.fleet == name for side in found):
            raise UsageError(f"task.fleets: '{name}' is named twice")
        if several and (not isinstance(acts, Mapping) or name not in acts):
            raise UsageError(f"task: {type(task).__name__}.acts: expected a dict of axes with one for fleet '{name}'")
        rows = slice(first, first + fleet.size)
        found.append(Side(name, fleet.vehicle_names, rows, tuple(acts[name] if several else acts)))
        first = rows.stop
    return tuple(found)


def width(sides: tuple[Side, ...]) -> int:
    """Return the size A of the action array: the largest number of action axes of any agent."""
    return max(len(side.axes) for side in sides)


def axes_of_agents(sides: tuple[Side, ...]) -> tuple[tuple[Axis, ...], ...]:
    """Return for each agent the description of its action's numbers."""
    return tuple(side.axes for side in sides for _ in side.names)


def in_units(sides: tuple[Side, ...], action: Any) -> Any:
    """Convert actions (n, A) in [-1, 1], clipped, to physical units; NumPy or JAX."""
    lib, most = library(action), width(sides)
    ends = []
    for end, nothing in (("low", -1.0), ("high", 1.0)):
        rows = [[getattr(axis, end) for axis in axes] for axes in axes_of_agents(sides)]
        ends.append(lib.asarray([row + [nothing] * (most - len(row)) for row in rows], action.dtype))
    low, high = ends
    action = lib.clip(action, -1.0, 1.0)
    if any(axis.neutral is not None for side in sides for axis in side.axes):
        # Where 0 is the middle of the range the numbers stay as they are, to the last bit.
        centre = _centres(lib, sides, most, action.dtype)
        action = centre + action * lib.where(action >= 0.0, 1.0 - centre, 1.0 + centre)
    return low + 0.5 * (action + 1.0) * (high - low)


def _centres(lib: Any, sides: tuple[Side, ...], most: int, dtype: Any) -> Any:
    """Return where 0 of each agent's action lies in its range (n, A), from -1 to 1; NumPy or JAX."""
    rows = []
    for side in sides:
        centres = [lib.asarray(axis.centre, dtype) for axis in side.axes]
        row = lib.stack(centres + [lib.asarray(0.0, dtype)] * (most - len(centres)))
        rows.append(lib.broadcast_to(row[None], (len(side.names), most)))
    return lib.concatenate(rows)


def apart(sides: tuple[Side, ...], action: Any) -> Any:
    """Split actions (n, A) into a dict fleet -> (n_f, A_f) if there are several fleets, else return them."""
    if len(sides) == 1:
        return action
    return {side.fleet: action[side.rows, : len(side.axes)] for side in sides}


def together(sides: tuple[Side, ...], given: Any, what: str = "action") -> Any:
    """Join actions by fleet (n_f, A_f) to one array (n, A), NumPy or JAX; the inverse of ``apart``.

    Args:
        sides: of several fleets.
        given: by fleet (n_f, A_f).
        what: it is, for messages.

    Raises:
        UsageError: no dict, a fleet is missing or unknown, or another shape.
    """
    names, most = [side.fleet for side in sides], width(sides)
    by_fleet(given, names, what)
    lib = jnp if any(isinstance(part, jax.Array) for part in given.values()) else np
    parts = []
    for side in sides:
        array, expected = lib.asarray(given[side.fleet]), (len(side.names), len(side.axes))
        if array.shape != expected:
            axes = ", ".join(axis.name for axis in side.axes)
            raise UsageError(f"{what} of fleet '{side.fleet}': expected shape {expected} ({axes}), found {array.shape}")
        parts.append(lib.pad(array, ((0, 0), (0, most - expected[1]))))
    return lib.concatenate(parts)


def by_fleet(given: object, names: list[str], what: str) -> None:
    """Raise UsageError unless ``given`` is a dict with one entry per fleet; ``what``: its name in the message.

    Raises:
        UsageError: it is not.
    """
    if not isinstance(given, dict):
        fleets = ", ".join(names)
        raise UsageError(f"{what}: expected a dict with one for each fleet, {fleets}; found {type(given).__name__}")
    for name in given:
        if name not in names:
            raise UsageError(f"{what}: no fleet of agents is called '{name}'{did_you_mean(str(name), names)}")
    missing = [name for name in names if name not in given]
    if missing:
        raise UsageError(f"{what}: there is none for fleet {', '.join(missing)}")


def of_all(sides: tuple[Side, ...], values: Any) -> Array:
    """Return a task's values (n,), such as rewards, joined from a dict by fleet if there are several."""
    return values if len(sides) == 1 else jnp.concatenate([values[side.fleet] for side in sides])


def part_of(sides: tuple[Side, ...], seen: Any, number: int) -> Any:
    """Return a copy of agent ``number``'s observation, leaves (B, ...), from all (B, n, ...), by fleet if several."""
    side = side_of(sides, number)
    mine = seen if len(sides) == 1 else seen[side.fleet]
    return jax.tree.map(lambda leaf: leaf[:, number - side.rows.start].copy(), mine)


def side_of(sides: tuple[Side, ...], number: int) -> Side:
    """Return the ``Side`` (fleet of agents) to which agent ``number`` belongs."""
    return next(side for side in sides if number < side.rows.stop)


def side_of_fleet(sides: tuple[Side, ...], fleet: str | None) -> Side:
    """Return the agents of a fleet; None: those of the first, or only one.

    Raises:
        UsageError: no agents are of that fleet.
    """
    names = [side.fleet for side in sides]
    if fleet is not None and fleet not in names:
        raise UsageError(f"no fleet of agents is called '{fleet}'{did_you_mean(fleet, names)}")
    return sides[0 if fleet is None else names.index(fleet)]
