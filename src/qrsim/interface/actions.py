"""Users' actions, checked and split into one action for each fleet."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.control import (
    SETPOINTS,
    AttitudeHeightSetpoint,
    Estimate,
    OffboardController,
    VelocityHeightSetpoint,
    WaypointSetpoint,
)
from qrsim.core.arrays import DType, Floats
from qrsim.core.tree import map_tree, walk
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError, did_you_mean
from qrsim.interface.arrays import library_for
from qrsim.interface.messages import Say, outboxes
from qrsim.models.vehicles.commands import fields_of, limits_of
from qrsim.world.state import Action, Fleet, Piloted, Saying, Some, World

T = TypeVar("T")
# Says which vehicles (n,) fly; called only where something is not finite.
Flying = Callable[[], Floats]
_NAME_OF = {cls: name for name, cls in SETPOINTS.items()}


class CommandKind:
    """A command record of a fleet: its fields, and their limits as the commands are rounded."""

    def __init__(self, kind: type, dtype: DType):
        self.kind, self.fields, self.limits = kind, fields_of(kind), limits_of(kind)
        # Rounded as the commands are, so that 0.9 is in its own range in single precision too.
        rows = np.array(list(self.limits.values()), dtype).reshape(-1, 2)
        self.lowest, self.highest = rows[:, 0], rows[:, 1]


class ActionChecker:
    """Checks commands and set-points for the fleets of a world.

    Args:
        world: whose vehicles are commanded.
        dtype: of its numbers.
        values: "checked" refuses commands out of their range; "finite" leaves clipping them to the tick, which flags
            it; "traced" is for a program that is being compiled, where kinds and shapes can be seen but no values.
    """

    def __init__(self, world: World, dtype: DType, values: Literal["checked", "finite", "traced"] = "checked"):
        self.fleets, self.dtype, self.values = world.fleets, dtype, values
        self._world = world
        self.traced = values == "traced"
        accepted = {kind for fleet in world.fleets for kind in fleet.vehicle.actions}
        self.kinds = {kind: CommandKind(kind, self.dtype) for kind in accepted}
        self.names = [name for fleet in world.fleets for name in fleet.vehicle_names]
        # Fleet, and number in it, of each vehicle.
        self._places: dict[object, tuple[str, int]] = {
            name: (fleet.name, row) for fleet in world.fleets for row, name in enumerate(fleet.vehicle_names)
        }

    def actions(self, command: object, flying: Flying | None = None) -> tuple[Action, ...]:
        """Check a user's command and convert it to the action of each fleet; see ``Simulation.step`` for the forms of
        commands.

        Args:
            command: for all vehicles, or by fleet or vehicle.
            flying: which vehicles fly. Commands of the others may be NaN, as their readings are.

        Raises:
            UsageError: wrong kind or shape, a number that is not finite or out of its range (vehicle, field, value
                and range are named), or an unknown fleet.
        """
        if command is None:
            return (None,) * len(self.fleets)
        if isinstance(command, Say):
            said = outboxes(
                command, self._world, [fleet.vehicle_names for fleet in self.fleets], self.dtype, self.traced
            )
            asked = self.actions(command.command, flying)
            return tuple(Saying(action, outbox) for action, outbox in zip(asked, said, strict=True))
        if isinstance(command, Mapping):
            return self._by_name(command, flying)
        whole = self._checked(command, self.names, self.fleets, flying)
        return tuple(self._cut(whole))

    def estimates(self, estimate: object, needed: bool = False) -> tuple[Estimate | None, ...]:
        """Check a user's estimate and convert it to one for each fleet; None for fleets that take their controllers'
        ``feed``.

        Args:
            estimate: of all vehicles, or None.
            needed: whether None is an error, as of an estimator that forgot to return something.

        Raises:
            UsageError: no Estimate, or arrays of another shape.
        """
        if estimate is None and not needed:
            return (None,) * len(self.fleets)
        if not isinstance(estimate, Estimate):
            raise UsageError(f"estimate: expected a qrsim.Estimate, found {estimate!r}")
        return tuple(self._cut(self._cast(estimate, "estimate", len(self.names))))

    def waypoint(self, position_ned: npt.ArrayLike, yaw_rad: npt.ArrayLike = 0.0) -> WaypointSetpoint:
        """Return a waypoint set-point for all vehicles: positions NED (n, 3) or (3,) [m], headings (n,) or one
        [rad]."""
        size = len(self.names)
        position = self._fitting("position_ned", position_ned, (size, 3))
        yaw = self._fitting("yaw_rad", yaw_rad, (size,))
        rows = np.empty((4, size), self.dtype)
        rows[:3], rows[3] = position.T, yaw
        if not np.logical_and.reduce(np.isfinite(rows), axis=None):
            what = "yaw_rad" if np.isfinite(rows[:3]).all() else "position_ned"
            row = int(np.argmin(np.isfinite(rows[3:] if what == "yaw_rad" else rows[:3]).all(axis=0)))
            raise UsageError(f"{what}: not finite for vehicle {row} ('{self.names[row]}')")
        north, east, down, heading = cast(Array, rows)
        return WaypointSetpoint(Vec3(north, east, down), heading)

    def _by_name(self, commands: Mapping[object, object], flying: Flying | None) -> tuple[Action, ...]:
        """Return the action of each fleet from commands by name of a fleet or vehicle; raises UsageError for unknown
        names."""
        rows: dict[str, dict[int, object]] = {fleet.name: {} for fleet in self.fleets}
        for name, command in commands.items():
            if name in rows:
                continue
            if name not in self._places:
                hint = did_you_mean(str(name), [*rows, *self.names])
                raise UsageError(f"command: no fleet and no vehicle is called '{name}'{hint}")
            fleet_name, row = self._places[name]
            rows[fleet_name][row] = command
        actions, first = [], 0
        for fleet in self.fleets:
            own_flying = None if flying is None else partial(_part, flying, slice(first, first + fleet.size))
            first += fleet.size
            command, of_vehicles = commands.get(fleet.name), rows[fleet.name]
            if command is None:
                actions.append(self._of_vehicles(fleet, of_vehicles, own_flying))
                continue
            if of_vehicles:
                raise UsageError(
                    f"command: '{fleet.vehicle_names[min(of_vehicles)]}' is of fleet '{fleet.name}', which is given a "
                    "command too; give one of both"
                )
            actions.append(self._of_fleet(command, fleet, own_flying))
        return tuple(actions)

    def _of_fleet(self, command: object, fleet: Fleet, flying: Flying | None) -> Action:
        """Return a fleet's action from a checked command for all its vehicles, radio messages included."""
        if not isinstance(command, Say):
            return self._checked(command, list(fleet.vehicle_names), (fleet,), flying)
        (said,) = outboxes(command, self._world, [fleet.vehicle_names], self.dtype, self.traced)
        asked = None if command.command is None else self._of_fleet(command.command, fleet, flying)
        return Saying(asked, said)

    def _of_vehicles(self, fleet: Fleet, rows: Mapping[int, object], flying: Flying | None) -> Action:
        """Return a fleet's action from commands by vehicle row; the other vehicles follow their scenario's guidance."""
        kinds: dict[type, dict[int, object]] = {}
        for row, command in rows.items():
            if command is None:
                continue
            name = fleet.vehicle_names[row]
            own_flying = None if flying is None else partial(_part, flying, slice(row, row + 1))
            one = self._checked(self._one_row(command, fleet), [name], (fleet,), own_flying)
            kinds.setdefault(type(one), {})[row] = one
        # Sorted, so that the same kinds of commands are the same program whichever vehicle comes first.
        parts = tuple(self._filled(fleet.size, kinds[kind]) for kind in sorted(kinds, key=lambda kind: kind.__name__))
        if len(parts) == 1 and len(next(iter(kinds.values()))) == fleet.size:
            return parts[0][1]
        return Some(parts) if parts else None

    def _one_row(self, command: object, fleet: Fleet) -> object:
        """Return a command for one vehicle as arrays (1, ...), the form for a fleet of one."""
        if type(command) in _NAME_OF or dataclasses.is_dataclass(command):
            return jax.tree.map(lambda leaf: leaf[None] if np.shape(leaf) == () else leaf, _arrays(command))
        if isinstance(command, str | bytes | Mapping | Say):
            raise UsageError(f"command: expected one of a vehicle of fleet '{fleet.name}', found {command!r}")
        try:
            flat = np.ndim(cast(npt.ArrayLike, command)) == 1
        except ValueError:
            return command
        return library_for(self.traced).asarray(command)[None] if flat else command

    def _filled(self, size: int, asked: Mapping[int, object]) -> tuple[Any, Any]:
        """Return which vehicles are commanded, (size,) bool, and their commands, given by row, as one record of arrays
        (size,)."""
        which = np.isin(np.arange(size), list(asked))
        first = next(iter(asked.values()))
        ones = [asked.get(row, first) for row in range(size)]
        library = library_for(self.traced)
        return which, jax.tree.map(lambda *leaves: library.concatenate(leaves), *ones)

    def _cut(self, whole: T) -> list[T]:
        """Split a command for all vehicles into one for each fleet."""
        if len(self.fleets) == 1:
            return [whole]
        parts, first = [], 0
        for fleet in self.fleets:
            parts.append(map_tree(partial(_rows, slice(first, first + fleet.size)), whole))
            first += fleet.size
        return parts

    def _checked(self, command: object, names: list[str], fleets: tuple[Fleet, ...], flying: Flying | None) -> object:
        """Check a command or set-point for some fleets and convert its arrays to the simulation's dtype; raises
        UsageError."""
        if type(command) in _NAME_OF:
            return self._setpoint(command, names, fleets, flying)
        if isinstance(command, Some | Piloted):
            # Checked by the links that make them: links/shared/latches.py and links/autopilot/flight.py.
            return command
        # A dataclass is never taken for an array; ``_kind`` refuses commands of another kind of vehicle.
        given = type(command) if dataclasses.is_dataclass(command) else None
        kind = self._kind(given, fleets)
        if given is not None:
            columns = self._cast(command, "command", len(names))
            return self._in_range(kind, list(vars(columns).values()), names, flying)
        if isinstance(command, str | bytes):
            raise UsageError(
                f"command: expected an array ({len(names)}, {len(kind.fields)}), a set-point, one of these for each "
                f"fleet by name, or None, found {command!r}"
            )
        return self._command(kind, command, names, flying)

    def _kind(self, given: type | None, fleets: tuple[Fleet, ...]) -> CommandKind:
        """Return the kind of command for a record's type ``given``, or, for None, for an array of the fleets' own
        command fields.

        Raises:
            UsageError: the fleets do not all take it.
        """
        kind = fleets[0].vehicle.command_type if given is None else given
        for fleet in fleets:
            taken = fleet.vehicle.actions if given else (fleet.vehicle.command_type,)
            if kind not in taken:
                alike = any(kind.__name__ == each.__name__ for each in fleet.vehicle.actions)
                names = " or ".join(_command_name(each, alike) for each in fleet.vehicle.actions)
                name = _command_name(kind, alike, article=True)
                raise UsageError(
                    f"command: {name} is not for the vehicles of fleet '{fleet.name}', "
                    f"which take {names}; give each fleet its own, by name"
                )
        return self.kinds[kind]

    def _setpoint(self, setpoint: object, names: list[str], fleets: tuple[Fleet, ...], flying: Flying | None) -> object:
        """Check a set-point and convert its arrays; raises UsageError if a fleet's controller does not take its
        type."""
        for fleet in fleets:
            if type(setpoint) not in fleet.controller.setpoints:
                name = _command_name(type(setpoint), article=True)
                raise UsageError(f"command: {name} is not for {_accepted_setpoints(fleet, setpoint)}")
        checked = self._cast(setpoint, "command", len(names))
        if not self.traced and isinstance(checked, VelocityHeightSetpoint | AttitudeHeightSetpoint):
            below = np.asarray(checked.z) > 0.0
            if below.any():
                row = int(np.argmax(below))
                raise UsageError(
                    f"command: z of vehicle {row} ('{names[row]}') is {checked.z[row]:g}, below the ground; z is down: "
                    f"{-checked.z[row]:g} is {checked.z[row]:g} m up"
                )
        if self.traced or np.isfinite(np.concatenate(jax.tree.leaves(checked))).all():
            return checked
        for field, values, _ in walk(checked):
            missing = _missing(values, flying)
            if missing.any():
                row = int(np.argmax(missing))
                raise UsageError(f"command: {field} of vehicle {row} ('{names[row]}') is not finite")
        return checked

    def _cast(self, record: T, what: str, size: int) -> T:
        """Return a record with its fields as arrays (``size``,) of the simulation's dtype; raises UsageError, naming
        ``what``, for other shapes."""
        leaves, structure = jax.tree.flatten(record)
        # The usual case at once: to carry the names of fields along takes as long as a tick.
        if not self.traced and all(_is_row(leaf, size) for leaf in leaves):
            return jax.tree.unflatten(structure, [np.ascontiguousarray(leaf, self.dtype) for leaf in leaves])

        def convert(path: tuple[object, ...], leaf: npt.ArrayLike) -> Floats | Array:
            """Return one field of a command as an array (n,); raises UsageError for another shape or no numbers."""
            name = "".join(str(part) for part in path).lstrip(".")
            if np.shape(leaf) != (size,):
                raise UsageError(f"{what}: {name}: expected shape {(size,)}, found {shape_of(leaf)}")
            try:
                return jnp.asarray(leaf, self.dtype) if self.traced else np.ascontiguousarray(leaf, self.dtype)
            except (TypeError, ValueError, OverflowError):
                raise UsageError(f"{what}: {name}: expected numbers, found {leaf!r}") from None

        return jax.tree_util.tree_map_with_path(convert, record)

    def _command(self, kind: CommandKind, command: object, names: list[str], flying: Flying | None) -> object:
        """Check an array (n, fields) and convert it to a command of a kind; raises UsageError for another shape or bad
        numbers."""
        shape = (len(names), len(kind.fields))
        try:
            array: Floats = (jnp if self.traced else np).asarray(command, self.dtype)
        except (TypeError, ValueError, OverflowError):
            array = np.zeros(0)
        if array.shape != shape:
            raise UsageError(
                f"command: expected shape {shape} (vehicles; {', '.join(kind.fields)}), found {shape_of(command)}"
            )
        # The usual case at once: column by column it takes longer than a tick.
        if not self.traced and self._all_fine(kind, array):
            return kind.kind(*np.ascontiguousarray(array.T))
        return self._in_range(kind, [array[:, i] for i in range(len(kind.fields))], names, flying)

    def _all_fine(self, kind: CommandKind, array: Floats) -> bool:
        """Return whether all commands (n, C) are finite and, if values are checked, in range: a quick test before the
        search for a wrong one."""
        if self.values != "checked":
            return bool(np.isfinite(array).all())
        # A field without limits may be anything but infinite.
        return bool((np.isfinite(array) & (array >= kind.lowest) & (array <= kind.highest)).all())

    def _in_range(self, kind: CommandKind, columns: list[Floats], names: list[str], flying: Flying | None) -> object:
        """Check a command's columns, each (n,), and return the command; raises UsageError for numbers out of range
        unless traced."""
        if self.traced:
            return kind.kind(*columns)
        checked: list[Floats] = []
        for field, values in zip(kind.fields, columns, strict=True):
            low, high = kind.limits[field]
            column = np.ascontiguousarray(values)
            wrong = _missing(column, flying)
            if self.values == "checked":
                # Rounding to single precision must not push 0.9 out of its own range.
                wrong |= (column < self.dtype.type(low)) | (column > self.dtype.type(high))
            if wrong.any():
                row = int(np.argmax(wrong))
                what = f"{field} of vehicle {row} ('{names[row]}')"
                raise UsageError(f"command: {what} is {column[row]:g}; allowed: {low:g} to {high:g}")
            checked.append(column)
        return kind.kind(*checked)

    def _fitting(self, what: str, values: npt.ArrayLike, shape: tuple[int, ...]) -> Floats:
        """Broadcast numbers to a shape; raises UsageError, naming ``what``, for text and shapes that do not fit."""
        try:
            array = np.asarray(values, self.dtype)
            return array if array.shape in ((), shape) else np.broadcast_to(array, shape)
        except (TypeError, ValueError, OverflowError):
            raise UsageError(f"{what}: expected numbers of shape {shape}, found {shape_of(values)}") from None


def _command_name(kind: type, with_module: bool = False, article: bool = False) -> str:
    """Return a command type's name for messages; ``with_module``: with its module, ``article``: with "a" or "an" in
    front."""
    name = f"{kind.__module__}.{kind.__name__}" if with_module else kind.__name__
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}" if article else name


def _accepted_setpoints(fleet: Fleet, setpoint: object) -> str:
    """Return a text for messages on the set-points that a fleet's controller takes, with a hint for ``setpoint``."""
    if not fields_of(fleet.vehicle.command_type):
        return f"fleet '{fleet.name}', whose vehicles take no commands; give each fleet its own, by name"
    taken = ", ".join(cls.__name__ for cls in fleet.controller.setpoints)
    hint = "; a controller of type 'offboard' takes it" if type(setpoint) in OffboardController.setpoints else ""
    return f"{type(fleet.controller).__name__}, which takes {taken}{hint}"


def _is_row(leaf: object, size: int) -> bool:
    """Return whether a value is a NumPy array of numbers with shape (``size``,)."""
    return isinstance(leaf, np.ndarray) and leaf.shape == (size,) and leaf.dtype.kind in "fiu"


def _rows(own: slice, leaf: Array) -> Array:
    """Return the elements of an array at the rows ``own``."""
    return leaf[own]


def _arrays(record: object) -> object:
    """Return a command record with its plain Python numbers converted to arrays."""
    return jax.tree.map(lambda leaf: np.asarray(leaf) if isinstance(leaf, int | float) else leaf, record)


def _part(flying: Flying, own: slice) -> Floats:
    """Return which vehicles still fly, (n,) bool, for the rows ``own``."""
    return flying()[own]


def _missing(values: Floats, flying: Flying | None) -> Floats:
    """Return for which vehicles, (n,) bool, a number is not finite although the vehicle still flies."""
    missing: Floats = ~np.isfinite(values)
    return missing & flying() if flying is not None and missing.any() else missing


def shape_of(values: object) -> str:
    """Return the shape of a user's value as text, for messages."""
    try:
        return f"shape {np.shape(cast(npt.ArrayLike, values))}"
    except ValueError:
        return "rows of different lengths"
