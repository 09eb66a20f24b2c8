"""Writes STATE messages straight from a simulation's buffers, without trees or protobuf."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.engine.layout import Buffers, Packer
from qrsim.links.reference.protocol.framing import HEAD_SIZE, frame
from qrsim.links.reference.protocol.qrsim_pb2 import Message, State
from qrsim.models.gnss.receivers import GnssReading
from qrsim.models.scene.area import reason_text
from qrsim.models.sensors.attitude import AttitudeReading
from qrsim.models.sensors.barometer import BarometerReading
from qrsim.models.sensors.imu import ImuReading
from qrsim.models.sensors.inertial import AccelerometerReading, GyroscopeReading
from qrsim.models.sensors.pressure import PressureReading
from qrsim.models.vehicles.contracts import Vehicle
from qrsim.world.state import FleetState, World

STATE_SIZE, MEASURED_SIZE = 13, 20
# Of the state vector, before the thrust.
POSE = ("position_ned", "attitude", "velocity_body", "rates_body")
# Columns of the measured vector that no sensor fills (docs/reference/tcp_protocol.md).
UNUSED = (6, 7, 8, 12)
# Bytes before the numbers of each vehicle: the tags and lengths of X or eX, and of the Arrayd in it.
_X_HEAD = bytes([0x12, 106, 0x0A, 104])
_EX_HEAD = bytes([0x1A, 0xA3, 0x01, 0x0A, 0xA0, 0x01])
# Of a Message: its type STATE, and the tag of the State in it.
_STATE_HEAD = b"\x08\x06\x3a"
_T_HEAD = b"\x09"
# Of a reason, and of one that is empty.
_REASON_HEAD, _NO_REASON = b"\xa2\x06", b"\xa2\x06\x00"
_X_STRIDE, _EX_STRIDE = len(_X_HEAD) + 8 * STATE_SIZE, len(_EX_HEAD) + 8 * MEASURED_SIZE
BYTES_PER_VEHICLE = _X_STRIDE + _EX_STRIDE


def varint(value: int) -> bytes:
    """Encode a non-negative integer as a protobuf varint."""
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*found, value])


def largest_fleet(limit: int) -> int:
    """Return the largest number of vehicles for which a STATE message fits into ``limit`` bytes, its length
    included."""
    count = limit // BYTES_PER_VEHICLE
    while state_size(count) > limit:
        count -= 1
    return count


def state_size(vehicles: int) -> int:
    """Return the size [bytes] of a STATE message for a number of vehicles, its length message included."""
    body = len(_T_HEAD) + 8 + vehicles * BYTES_PER_VEHICLE
    return HEAD_SIZE + 3 + len(varint(body)) + body


class Source(Protocol):
    """Source of a STATE: a simulation after its reset, or an episode."""

    @property
    def size(self) -> int:
        """Number of vehicles."""

    @property
    def time(self) -> float:
        """Simulated time [s]."""

    @property
    def world(self) -> World:
        """World (parameters) of the state that is sent."""

    @property
    def packed(self) -> tuple[Packer, Buffers]:
        """Layout and flat buffers of the world's state."""


def places_of(simulation: Source) -> Any:
    """Return the tree of a world's state with, in place of its numbers, their indices in the flat buffers."""
    layout, _ = simulation.packed
    floats, integers = layout.sizes
    return layout.unpack((np.arange(floats), np.arange(integers, dtype=np.int32)))


class Readout:
    """Writes STATE messages of one simulation.

    The measured vector is NaN where a fleet lacks the sensor and where a sensor has no reading. Where a fleet has
    several of a kind, the first one counts. Where no sensor reports an attitude, that of the estimator does.

    Args:
        simulation: whose state.
        reasons: say why each vehicle is invalid, which is an extension.
    """

    def __init__(self, simulation: Source, reasons: bool = False):
        self._simulation, self._explains = simulation, reasons
        count = simulation.size
        body = len(_T_HEAD) + 8 + count * BYTES_PER_VEHICLE
        self._body_size, tail = body, _NO_REASON * count if reasons else b""
        body += len(tail)
        head = _STATE_HEAD + varint(body)
        self._body_at = HEAD_SIZE + len(head)
        x_at = self._body_at + len(_T_HEAD) + 8
        content = frame(
            head
            + _T_HEAD
            + bytes(8)
            + _X_HEAD.ljust(_X_STRIDE, b"\0") * count
            + _EX_HEAD.ljust(_EX_STRIDE, b"\0") * count
            + tail
        )
        self._buffer = bytearray(content)
        self._time = np.ndarray((1,), "<f8", self._buffer, x_at - 8)
        self._x = np.ndarray((count, STATE_SIZE), "<f8", self._buffer, x_at + len(_X_HEAD), (_X_STRIDE, 8))
        ex_at = x_at + count * _X_STRIDE + len(_EX_HEAD)
        self._ex = np.ndarray((count, MEASURED_SIZE), "<f8", self._buffer, ex_at, (_EX_STRIDE, 8))
        self._ex[...] = np.nan
        self._ex[:, UNUSED] = 0.0
        self._find_places(simulation)

    def _find_places(self, simulation: Source) -> None:
        """Find and store the indices of every vehicle's state vector in the flat buffers."""
        places = places_of(simulation)
        self._x_places = np.concatenate([_state_places(fleet) for fleet in places.fleets])
        # Vehicles from outside can have a state without a thrust, for example.
        self._unknown = self._x_places < 0 if (self._x_places < 0).any() else None
        self._posed = _posed(simulation.world, places.fleets)
        self._low_places = _low_places(places.fleets)
        self._codes = np.concatenate([fleet.violation.code for fleet in places.fleets])
        self._values = np.concatenate([fleet.violation.value for fleet in places.fleets])
        rows, columns, sources, first = [], [], [], 0
        for fleet in places.fleets:
            size = len(fleet.violation.code)
            for column, source in _measured_places(fleet).items():
                rows.append(np.arange(first, first + size))
                columns.append(np.full(size, column))
                sources.append(source)
            first += size
        nothing = [np.zeros(0, np.int64)]
        self._ex_rows, self._ex_columns, self._ex_places = (
            np.concatenate(nothing + parts) for parts in (rows, columns, sources)
        )

    def frame(self) -> bytes:
        """Return the present STATE message as bytes, framed with its length."""
        floats = np.asarray(self._simulation.packed[1][0])
        self._time[0] = self._simulation.time
        self.vectors()
        self._ex[self._ex_rows, self._ex_columns] = floats.take(self._ex_places)
        if self._explains and not self.all_valid():
            return self._explained()
        return bytes(self._buffer)

    def vectors(self) -> NumpyArray:
        """Return the present state vectors (n, 13), in a buffer that the next call overwrites."""
        floats = np.asarray(self._simulation.packed[1][0])
        self._x[...] = floats.take(self._x_places)
        if self._unknown is not None:
            self._x[self._unknown] = np.nan
        for posed in self._posed:
            self._x[posed.rows] = posed.vectors(*self._simulation.packed)
        if self._low_places is not None:
            self._x[:, :3] += floats.take(self._low_places)
        return self._x

    def _explained(self) -> bytes:
        """Return the framed STATE message, with the reason for each invalid vehicle appended."""
        floats, integers = self._simulation.packed[1]
        codes, values = np.asarray(integers).take(self._codes), np.asarray(floats).take(self._values)
        body = bytes(self._buffer[self._body_at : self._body_at + self._body_size])
        for code, value in zip(codes.tolist(), values.tolist(), strict=True):
            text = reason_text(code, value).encode()
            body += _REASON_HEAD + varint(len(text)) + text
        return frame(_STATE_HEAD + varint(len(body)) + body)

    def message(self) -> State:
        """Return the present state as a protobuf ``State``."""
        return Message.FromString(self.frame()[HEAD_SIZE:]).state

    def all_valid(self) -> bool:
        """Return whether all vehicles still fly."""
        return not np.count_nonzero(np.asarray(self._simulation.packed[1][1]).take(self._codes))


class States:
    """The STATE messages of one simulation, for those who want reasons and for those who do not."""

    def __init__(self, simulation: Source):
        self._simulation = simulation
        self._plain = Readout(simulation)
        self._explaining: Readout | None = None

    def frame(self, reasons: bool = False) -> bytes:
        """Return the present STATE message as bytes, framed with its length; ``reasons``: why vehicles are invalid,
        too."""
        return (self._with_reasons() if reasons else self._plain).frame()

    def vectors(self) -> NumpyArray:
        """Return the present state vectors (n, 13)."""
        return self._plain.vectors()

    def message(self) -> State:
        """Return the present state as a protobuf ``State``, with reasons for invalid vehicles."""
        return self._with_reasons().message()

    def all_valid(self) -> bool:
        """Return whether all vehicles still fly."""
        return self._plain.all_valid()

    def _with_reasons(self) -> Readout:
        """Return the encoder that adds reasons to STATE messages, built at the first call."""
        self._explaining = self._explaining or Readout(self._simulation, reasons=True)
        return self._explaining


class _Posed:
    """A fleet whose own state is not the state vector, as one with a quaternion: its model says the pose.

    Args:
        vehicle: the model.
        number: of the fleet.
        rows: of its vehicles.
    """

    def __init__(self, vehicle: Vehicle, number: int, rows: slice):
        self._vehicle, self._number, self.rows = vehicle, number, rows
        self._compiled = jax.jit(_vectors)

    def vectors(self, layout: Packer, buffers: Buffers) -> NumpyArray:
        """Return the state vectors (n, 13) of these vehicles from a packed state, with positions without their rounding
        remainders."""
        part = layout.numbers.fleets[self._number].vehicle
        state = jax.tree.map(lambda number: np.asarray(layout.leaf(buffers, number)), part)
        with jax.enable_x64(layout.dtype == np.float64):
            return np.asarray(self._compiled(self._vehicle, state))


def _vectors(vehicle: Vehicle, state: Any) -> jax.Array:
    """Return position, attitude, velocity, rates and thrust of a fleet's vehicles as state vectors (n, 13)."""
    pose, like = vehicle.pose(state), state.position_ned.x
    thrust = jnp.broadcast_to(jnp.asarray(vehicle.load(state).thrust), like.shape)
    return jnp.stack([*jax.tree.leaves(pose), thrust], axis=1)


def _posed(world: World, fleets: Sequence[FleetState]) -> list[_Posed]:
    """Return the fleets whose state vectors need the vehicle's method ``pose``, as their states lack a part of it."""
    found, first = [], 0
    for number, (fleet, state) in enumerate(zip(world.fleets, fleets, strict=True)):
        rows = slice(first, first + fleet.size)
        first += fleet.size
        if not all(name in vars(state.vehicle) for name in POSE):
            found.append(_Posed(fleet.vehicle, number, rows))
    return found


def _state_places(fleet: FleetState) -> NumpyArray:
    """Return the indices (n, 13) of a fleet's state vectors in the flat float buffer; -1 for parts that the state
    lacks."""
    own = vars(fleet.vehicle)
    nothing = np.full(len(fleet.violation.code), -1)
    columns: list[NumpyArray] = []
    for name in POSE:
        columns += vars(own[name]).values() if name in own else [nothing] * 3
    return np.stack([*columns, own.get("thrust", nothing)], axis=1)


def _low_places(fleets: Sequence[FleetState]) -> NumpyArray | None:
    """Return the indices (n, 3), in the flat float buffer, of the rounding remainders of positions; None in double
    precision."""
    lows = [fleet.position_low_ned for fleet in fleets]
    if any(low is None for low in lows):
        return None
    return np.concatenate([np.stack([low.x, low.y, low.z], axis=1) for low in lows if low is not None])


def _measured_places(fleet: FleetState) -> dict[int, object]:
    """Return column of the measured state vector -> indices (n,) of the sensors' numbers in the flat float buffer."""
    found: dict[int, object] = {}
    for reading in reversed(fleet.readings):
        if isinstance(reading, GnssReading):
            position, velocity = reading.position_ned, reading.velocity_ned
            found |= {0: position.x, 1: position.y, 2: position.z, 17: velocity.x, 18: velocity.y}
        elif isinstance(reading, AttitudeReading):
            found |= {3: reading.attitude.roll, 4: reading.attitude.pitch, 5: reading.attitude.yaw}
        elif isinstance(reading, GyroscopeReading):
            found |= {9: reading.rates_body.x, 10: reading.rates_body.y, 11: reading.rates_body.z}
        elif isinstance(reading, AccelerometerReading):
            force = reading.specific_force
            found |= {13: force.x, 14: force.y, 15: force.z}
        elif isinstance(reading, ImuReading):
            rates, force = reading.rates_body, reading.specific_force
            found |= {9: rates.x, 10: rates.y, 11: rates.z, 13: force.x, 14: force.y, 15: force.z}
        elif isinstance(reading, BarometerReading | PressureReading):
            found |= {16: reading.height, 19: reading.height_rate}
    if 3 not in found and fleet.belief is not None:
        attitude = fleet.belief.estimate.attitude
        found |= {3: attitude.roll, 4: attitude.pitch, 5: attitude.yaw}
    return found
