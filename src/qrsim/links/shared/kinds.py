"""Kinds of orders: what a controller may ask of one vehicle, and which of it a fleet takes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from qrsim.control.setpoints import SETPOINTS
from qrsim.core.arrays import DType, NumpyArray
from qrsim.core.tree import field_info
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError, did_you_mean
from qrsim.links.contracts import Order
from qrsim.models.vehicles.commands import limits_of
from qrsim.world.state import Fleet

CONTROL = "control"
# Names and units of the numbers of each kind of set-point, in the order of its record.
FIELDS: dict[str, tuple[tuple[str, str], ...]] = {
    "waypoint": (("x", "m"), ("y", "m"), ("z", "m"), ("yaw", "rad")),
    "velocity": (("velocity_north", "m/s"), ("velocity_east", "m/s"), ("velocity_down", "m/s"), ("yaw", "rad")),
    "velocity_height": (("velocity_north", "m/s"), ("velocity_east", "m/s"), ("z", "m"), ("yaw", "rad")),
    "attitude_height": (("roll", "rad"), ("pitch", "rad"), ("z", "m"), ("yaw", "rad")),
    "attitude": (("roll", "rad"), ("pitch", "rad"), ("yaw", "rad"), ("throttle", "1")),
    "path": (
        ("x", "m"),
        ("y", "m"),
        ("z", "m"),
        ("velocity_north", "m/s"),
        ("velocity_east", "m/s"),
        ("velocity_down", "m/s"),
        ("acceleration_north", "m/s^2"),
        ("acceleration_east", "m/s^2"),
        ("acceleration_down", "m/s^2"),
        ("yaw", "rad"),
    ),
    "track": (
        ("begin_x", "m"),
        ("begin_y", "m"),
        ("begin_z", "m"),
        ("x", "m"),
        ("y", "m"),
        ("z", "m"),
        ("radius", "m"),
        ("speed", "m/s"),
        ("stops", "1"),
    ),
}
# Which of their numbers are a position down, which no vehicle can be sent to below the ground.
_DOWN = {"velocity_height": 2, "attitude_height": 2}
# Lines and circles came after recordings had numbers for all others.
TRACK = "track"
# By number in a recording: 0 is the guidance of the scenario.
NAMES = (*(kind for kind in FIELDS if kind != TRACK), CONTROL, TRACK)


@dataclass(frozen=True)
class Field:
    """One number of an order, with its range."""

    name: str
    unit: str
    low: float = -math.inf
    high: float = math.inf


def kinds_of(fleet: Fleet) -> dict[str, tuple[Field, ...]]:
    """Return the kinds of orders that a fleet's vehicles take, each with its number fields; {} if they take none."""
    command = fleet.vehicle.command_type
    limits = limits_of(command)
    if not limits:
        return {}
    taken = {
        kind: tuple(Field(*field) for field in fields)
        for kind, fields in FIELDS.items()
        if SETPOINTS[kind] in fleet.controller.setpoints
    }
    units = _units_by_field(command)
    return {**taken, CONTROL: tuple(Field(name, units[name], *span) for name, span in limits.items())}


def _units_by_field(command: type) -> dict[str, str]:
    """Return field -> unit of a command class; "1" for numbers without a unit."""
    return {field.name: field_info(field).unit or "1" for field in dataclasses.fields(command)}


def record_of(kind: str, columns: NumpyArray, command: type) -> object:
    """Return the set-points or commands of n vehicles as one record, from numbers (V, n) of an order kind.

    Args:
        kind: one of NAMES.
        columns: (V, n) its numbers; the record holds views of them.
        command: the fleet's own record, for "control".
    """
    if kind == CONTROL:
        return command(*columns)
    record = SETPOINTS[kind]
    if kind in ("waypoint", "velocity"):
        return record(Vec3(*columns[:3]), columns[3])
    if kind == "path":
        return record(Vec3(*columns[:3]), Vec3(*columns[3:6]), Vec3(*columns[6:9]), columns[9])
    if kind == TRACK:
        return record(Vec3(*columns[:3]), Vec3(*columns[3:6]), *columns[6:])
    return record(*columns)


def checked(order: Order, kinds: Mapping[str, tuple[Field, ...]], dtype: DType) -> Order:
    """Return an order unchanged; raises UsageError if the vehicle does not take its kind (a key of ``kinds``) or a
    number is invalid.

    Raises:
        UsageError: its kind is not one that the vehicle takes, or a number is missing, not finite or out of its range.
    """
    what = f"'{order.vehicle}': {order.kind}"
    if order.kind not in kinds:
        raise UsageError(
            f"'{order.vehicle}' takes no order of kind '{order.kind}'{did_you_mean(order.kind, kinds)}; it takes "
            f"{', '.join(kinds)}"
        )
    fields = kinds[order.kind]
    if len(order.numbers) != len(fields):
        names = ", ".join(field.name for field in fields)
        raise UsageError(f"{what}: {len(order.numbers)} numbers; expected {len(fields)} ({names})")
    largest = float(np.finfo(dtype).max)
    for field, number in zip(fields, order.numbers, strict=True):
        if not abs(number) <= largest:
            raise UsageError(f"{what}: {field.name} is {number:g}, which is not finite")
        # Rounding to single precision must not push 0.9 out of its own range.
        if not dtype.type(field.low) <= dtype.type(number) <= dtype.type(field.high):
            raise UsageError(f"{what}: {field.name} is {number:g}; allowed: {field.low:g} to {field.high:g}")
    place = _DOWN.get(order.kind)
    if place is not None and order.numbers[place] > 0.0:
        z = order.numbers[place]
        raise UsageError(f"{what}: z is {z:g}, below the ground; z is down: {-z:g} is {z:g} m up")
    return order
