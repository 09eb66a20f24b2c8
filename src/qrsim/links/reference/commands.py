"""Commands of STEP messages as arrays for the simulation, allocated once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from qrsim.control import VelocitySetpoint, WaypointSetpoint
from qrsim.core.arrays import DType, NumpyArray
from qrsim.errors import UsageError
from qrsim.files import Content
from qrsim.links.reference.kinds import KINDS, WIDTHS
from qrsim.links.reference.protocol.qrsim_pb2 import Arrayd, Message, Step
from qrsim.links.shared.kinds import CONTROL, FIELDS, record_of
from qrsim.models.vehicles.commands import fields_of, limits_of
from qrsim.models.vehicles.quadrotor import Command
from qrsim.world.state import Fleet

# Tags and lengths of a vector and of the Arrayd in it.
HEAD_SIZE = 4


def rows_of(given: Sequence[Arrayd], widths: Sequence[int], what: str, names: Sequence[str]) -> list[list[float]]:
    """Return a message's vectors (``given``) as lists of numbers, one for each vehicle; raises UsageError for a wrong
    number or length.

    Args:
        given: the vectors.
        widths: how many numbers each may have, the same for all.
        what: they are, for messages.
        names: of the vehicles.

    Raises:
        UsageError: their number or lengths are wrong.
    """
    if len(given) != len(names):
        raise UsageError(f"{what}: {len(given)} vectors; expected {len(names)}, one for each vehicle")
    found = [list(row.value) for row in given]
    width = len(found[0])
    for i, row in enumerate(found):
        if len(row) not in widths:
            allowed = " or ".join(map(str, widths))
            raise UsageError(f"{what} of vehicle {i} ('{names[i]}'): {len(row)} numbers; expected {allowed}")
        if len(row) != width:
            raise UsageError(f"{what}: vectors of {width} and of {len(row)} numbers; expected the same for all")
    return found


@dataclass(frozen=True)
class _Known:
    """The bytes of a STEP around its numbers, and what they mean.

    Attributes:
        begin: all that comes before the first number of a vector, the time among it.
        ticks: that time in time steps.
        numbers: (n, width) what the vectors go into.
        command: that has these numbers.
    """

    begin: bytes
    ticks: int
    numbers: NumpyArray
    command: Any


class Commands:
    """Converts STEPs to commands of vehicles of one type; a command is valid until the next one of its kind.

    A client sends many STEPs that differ in the numbers of their vectors alone. Those are not parsed again.

    Args:
        names: of the vehicles.
        dtype: of the simulation's numbers.
    """

    def __init__(self, names: Sequence[str], dtype: DType):
        self._names = names
        self._made = {kind: _command_of_array(kind, len(names), dtype) for kind in KINDS}
        # By length, of which there is one at a time.
        self._known: dict[int, _Known] = {}
        self._last: bytes = b""

    def of(self, request: Step) -> Any:
        """Convert a STEP message to a command for ``Simulation.step``; raises UsageError for wrong vectors.

        Raises:
            UsageError: the number of vectors or of their entries is wrong.
        """
        numbers, command = self._made[request.type]
        rows = rows_of(request.cmd, (WIDTHS[request.type],), "cmd", self._names)
        # What is too large for the simulation's numbers becomes infinite, and is refused as such.
        with np.errstate(over="ignore"):
            numbers[...] = rows
        return command

    def samples(self, start_ned: NumpyArray) -> list[object]:
        """Return a waypoint, a velocity and a control command for vehicles at (n, 3) NED [m], to compile each kind in
        advance."""
        hover = np.tile([0.0, 0.0, 0.5, 0.0, 12.0], (len(start_ned), 1))
        return [WaypointSetpoint.of(start_ned), VelocitySetpoint.of(np.zeros_like(start_ned)), hover]

    def learn(self, payload: bytes, request: Step, ticks: int) -> None:
        """Store how a STEP message is laid out in bytes, so that later ones that differ only in numbers need no
        parsing.

        Args:
            payload: the message as it came.
            request: what is in it, and right.
            ticks: its time in time steps.
        """
        width = WIDTHS[request.type]
        begin = payload[: len(payload) - len(self._names) * (HEAD_SIZE + 8 * width) + HEAD_SIZE]
        # The second one of its kind is worth the effort, if it is written as protobuf itself writes it.
        known = self._known.get(len(payload))
        if begin == self._last and (known is None or known.begin != begin):
            plain = Step(dt=request.dt, type=request.type, cmd=[Arrayd(value=row.value) for row in request.cmd])
            if payload == Message(type=Message.STEP, step=plain).SerializeToString():
                self._known[len(payload)] = _Known(begin, ticks, *self._made[request.type])
        self._last = begin

    def known(self, payload: bytes) -> tuple[Any, int] | None:
        """Return the command and number of ticks of a STEP with a stored layout, read without parsing; None for
        others."""
        known = self._known.get(len(payload))
        if known is None or not payload.startswith(known.begin):
            return None
        count, width = known.numbers.shape
        first, stride = len(known.begin), HEAD_SIZE + 8 * width
        if count > 1:
            heads = np.ndarray((count, HEAD_SIZE), np.uint8, payload, first - HEAD_SIZE, (stride, 1))
            if (heads != heads[0]).any():
                return None
        given = np.ndarray((count, width), "<f8", payload, first, (stride, 8))
        with np.errstate(over="ignore"):
            known.numbers[...] = given
        return known.command, known.ticks


class MixedCommands(Commands):
    """Converts STEPs to commands of fleets whose vehicles take different ones, by the names of the fleets.

    Args:
        fleets: of the world.
        dtype: of the simulation's numbers.
    """

    def __init__(self, fleets: Sequence[Fleet], dtype: DType):
        super().__init__([name for fleet in fleets for name in fleet.vehicle_names], dtype)
        self._fleets, self._dtype = fleets, dtype

    def of(self, request: Step) -> Content:
        """Convert a STEP message to a command for each fleet; vectors of vehicles that take no commands are ignored.

        Raises:
            UsageError: the number of vectors or of their entries is wrong.
        """
        if len(request.cmd) != len(self._names):
            raise UsageError(f"cmd: {len(request.cmd)} vectors; expected {len(self._names)}, one for each vehicle")
        found, first = {}, 0
        for fleet in self._fleets:
            own = slice(first, first + fleet.size)
            first += fleet.size
            fields = fields_of(fleet.vehicle.command_type)
            if fields:
                width = len(fields) if request.type == Step.CTRL else WIDTHS[request.type]
                rows = rows_of(request.cmd[own], (width,), "cmd", self._names[own])
                with np.errstate(over="ignore"):
                    found[fleet.name] = _command(request.type, np.asarray(rows).astype(self._dtype))
        return found

    def samples(self, start_ned: NumpyArray) -> list[Any]:
        """Return a command of each kind for each fleet, for vehicles at (n, 3) NED [m], to compile them in advance."""
        found: list[Content] = [{}, {}, {}]
        first = 0
        for fleet in self._fleets:
            place = start_ned[first : first + fleet.size]
            first += fleet.size
            limits = limits_of(fleet.vehicle.command_type)
            if limits:
                middle = [float(np.clip(0.5 * (low + high), -1e3, 1e3)) for low, high in limits.values()]
                found[0][fleet.name] = WaypointSetpoint.of(place)
                found[1][fleet.name] = VelocitySetpoint.of(np.zeros_like(place))
                found[2][fleet.name] = np.tile(middle, (fleet.size, 1))
        return found

    def learn(self, payload: bytes, request: Step, ticks: int) -> None:
        """Do nothing: vectors of mixed fleets differ in length, so that every STEP message is parsed."""


def commands_of(fleets: Sequence[Fleet], dtype: DType) -> Commands:
    """Return the converter from STEP messages to commands for these fleets; a ``MixedCommands`` if their command types
    differ."""
    if all(fleet.vehicle.command_type is Command for fleet in fleets):
        return Commands([name for fleet in fleets for name in fleet.vehicle_names], dtype)
    return MixedCommands(fleets, dtype)


def _command_of_array(kind: int, size: int, dtype: DType) -> tuple[NumpyArray, object]:
    """Return a buffer (n, width) for a STEP's vectors, and the fleet's command, a view of it; ``kind``: the STEP's
    type.

    The fields of the command are views of the array's columns.
    """
    if KINDS[kind] == CONTROL:
        control = np.zeros((size, WIDTHS[kind]), dtype)
        return control, control
    # VEL has one number less than a velocity, whose heading is 0 then.
    columns = np.zeros((len(FIELDS[KINDS[kind]]), size), dtype)
    return columns[: WIDTHS[kind]].T, record_of(KINDS[kind], columns, Command)


def _command(kind: int, rows: NumpyArray) -> object:
    """Return a fleet's command from a STEP's vectors (n, width); ``kind``: the STEP's type, a key of ``KINDS``."""
    if KINDS[kind] == CONTROL:
        return rows
    numbers, command = _command_of_array(kind, len(rows), rows.dtype)
    numbers[...] = rows
    return command
