"""READINGS and SENSED of single vehicles, stamped: of a running world, for many receivers in each tick."""

from __future__ import annotations

import struct
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.reference.protocol.framing import frame
from qrsim.links.reference.protocol.qrsim_pb2 import Message, Readings
from qrsim.links.reference.radio import heard_by_all, heard_bytes
from qrsim.links.reference.readout import STATE_SIZE, States, places_of, varint
from qrsim.links.reference.sensors import sensor_of
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet

_HEADS = {
    Message.READINGS: b"\x08\x6a\xd2\x06",
    Message.SENSED: b"\x08\x7a\xd2\x07",
}
# Tags of Readings: time (double), vehicle, tick (varint), sent (double), missed (varint).
_TIME, _VEHICLE, _TICK, _SENT, _MISSED = b"\x09", b"\x12", b"\x18", b"\x21", b"\x28"
_X = b"\x2a" + varint(8 * STATE_SIZE + 2) + b"\x0a" + varint(8 * STATE_SIZE)


class Sensed:
    """Writes what each vehicle of one simulation senses, once a tick however many ask for it.

    Args:
        simulation: reset.
        states: of it.
    """

    def __init__(self, simulation: Simulation, states: States):
        self._simulation, self._states = simulation, states
        self._names = simulation.vehicle_names
        places = places_of(simulation)
        self._codes = np.concatenate([fleet.violation.code for fleet in places.fleets])
        self._fleets, first = [], 0
        for number, (fleet, state) in enumerate(zip(simulation.world.fleets, places.fleets, strict=True)):
            self._fleets.append(_FleetSensed(simulation, fleet, number, state, first))
            first += fleet.size
        self._of_row = [(fleet, row) for fleet in self._fleets for row in range(fleet.size)]
        self._tick = -1
        self._written: dict[int, bytes] = {}
        self._vectors: NumpyArray | None = None
        # Of all vehicles, once somebody asks.
        self._heard: list[list[Readings.Heard]] = []

    def frame(self, kind: Message.Type, rows: Sequence[int], truth: bool, missed: int = 0) -> bytes:
        """Return a framed READINGS or SENSED message (``kind``) with the readings of vehicles ``rows``; ``truth``: true
        states too.

        Args:
            kind: READINGS or SENSED.
            rows: of the vehicles.
            truth: with their true states.
            missed: readings that its receiver was too slow for.
        """
        self._drop_stale()
        body = [_TIME, struct.pack("<d", self._simulation.time)]
        for row in rows:
            content = self._encoded_vehicle(row)
            if truth:
                content += _X + self._state_bytes(row)
            body += [_VEHICLE, varint(len(content)), content]
        sent = struct.pack("<d", time.monotonic())
        body += [_TICK, varint(self._simulation.tick), _SENT, sent, _MISSED, varint(missed)]
        whole = b"".join(body)
        return frame(_HEADS[kind] + varint(len(whole)) + whole)

    def _drop_stale(self) -> None:
        """Drop the values cached at an earlier tick."""
        if self._tick != self._simulation.tick:
            self._tick, self._vectors, self._heard = self._simulation.tick, None, []
            self._written.clear()
            for fleet in self._fleets:
                fleet.look()
            self._flies = np.asarray(self._simulation.packed[1][1]).take(self._codes) == 0

    def _state_bytes(self, row: int) -> bytes:
        """Return the true state vector of the vehicle at ``row`` as protobuf bytes."""
        if self._vectors is None:
            self._vectors = self._states.vectors()
        return self._vectors[row].tobytes()

    def _encoded_vehicle(self, row: int) -> bytes:
        """Return the readings and received radio messages of the vehicle at ``row`` as protobuf bytes, cached for this
        tick."""
        encoded = self._written.get(row)
        if encoded is None:
            fleet, own = self._of_row[row]
            encoded = fleet.vehicle(own, self._names[row], bool(self._flies[row]))
            if self._simulation.world.radio is not None:
                self._heard = self._heard or heard_by_all(self._simulation)
                encoded += heard_bytes(self._heard[row])
            self._written[row] = encoded
        return encoded


class _FleetSensed:
    """What the sensors of one fleet say at a tick."""

    def __init__(self, simulation: Simulation, fleet: Fleet, number: int, places: Any, first: int):
        self.size, self._fleet, self._number, self._first = fleet.size, fleet, number, first
        self._simulation = simulation
        pairs = zip(fleet.sensor_names, places.readings, strict=True)
        found = [sensor_of(name, reading, simulation.site) for name, reading in pairs]
        self._sensors = [sensor for sensor in found if sensor is not None]
        self._quick = len(self._sensors) == len(found)
        self._templates: dict[int, tuple[bytearray, NumpyArray, NumpyArray]] = {}
        # Of vehicles that have stopped: why each sensor says nothing, and why they have.
        self._last_words: dict[int, tuple[str, list[str]]] = {}
        self._values: NumpyArray | None = None
        self._reading: Any = None

    def look(self) -> None:
        """Drop the values cached at an earlier tick."""
        self._values = self._reading = None

    def _measured(self) -> tuple[NumpyArray, NumpyArray]:
        """Return the fleet's readings with the times [s] of its sensors behind them, (n, V + S), and whether each
        sensor's is new, (n, S) bool."""
        if self._values is None:
            simulation = self._simulation
            floats = np.asarray(simulation.packed[1][0])
            parts = [sensor.values(floats) for sensor in self._sensors]
            times, fresh = self._timing()
            none = np.zeros((self.size, 0))
            self._values = np.ascontiguousarray(np.concatenate([none, *parts, times], axis=1, dtype=np.float64))
            self._fresh = fresh
        return self._values, self._fresh

    def _timing(self) -> tuple[NumpyArray, NumpyArray]:
        """Return when each sensor's reading was taken (n, S) [s], and whether it arrives at this tick (n, S) bool."""
        simulation, fleet = self._simulation, self._fleet
        tick: Any = simulation.tick
        dt = simulation.world.time_step
        count = len(fleet.sensors)
        times, fresh = np.zeros((self.size, count)), np.zeros((self.size, count), bool)
        for i, sensor in enumerate(fleet.sensors):
            fitting = fleet.fitting(i)
            if fitting is None or not fitting.is_late:
                times[:, i], fresh[:, i] = sensor.time_of_reading(tick, dt) * dt, sensor.fresh(tick, dt)
                continue
            reading = getattr(self._fleet_reading()[fleet.name], fleet.sensor_names[i])
            times[:, i], fresh[:, i] = reading.time_of_reading, reading.fresh
        return times, fresh

    def _fleet_reading(self) -> Any:
        """Return the simulation's present reading, cached for this tick."""
        if self._reading is None:
            self._reading = self._simulation.reading
        return self._reading

    def vehicle(self, row: int, name: str, flies: bool) -> bytes:
        """Return the readings of the vehicle at ``row`` of the fleet as protobuf bytes; ``flies``: it has not
        stopped."""
        if not self._quick:
            return self._by_protobuf(row, name, flies)
        values, fresh = self._measured()
        if not flies or not np.isfinite(values[row]).all():
            return self._by_protobuf(row, name, flies)
        if row not in self._templates:
            self._templates[row] = self._template(name)
        buffer, numbers, flags = self._templates[row]
        content = np.frombuffer(buffer, np.uint8)
        content[numbers] = values[row].view(np.uint8)
        content[flags] = fresh[row]
        return bytes(buffer)

    def _template(self, name: str) -> tuple[bytearray, NumpyArray, NumpyArray]:
        """Return a vehicle's encoded message, and the byte offsets in it at which its numbers and its flags are to be
        written."""
        count = self._measured()[0].shape[1]
        # Each number says its own place: what protobuf makes of them is searched once.
        marks = np.float64(2.0**40) + np.arange(count) * np.pi
        content = self._vehicle_message(name, marks, np.ones(len(self._sensors), bool)).SerializeToString()
        numbers = [content.index(struct.pack("<d", mark)) for mark in marks]
        flags = []
        for mark in marks[count - len(self._sensors) :]:
            # After the time of its reading.
            flags.append(content.index(struct.pack("<d", mark)) + 8 + 1)
        places = (np.array(numbers, int)[:, None] + np.arange(8)).ravel()
        return bytearray(content), places, np.array(flags, int)

    def _vehicle_message(
        self, name: str, values: NumpyArray, fresh: NumpyArray, why: str = "", reasons: Sequence[str] = ()
    ) -> Any:
        """Return a vehicle's protobuf message from values with times behind them (V + S,), freshness (S,), why it
        stopped, and reasons for missing readings."""
        message = Readings.Vehicle(name=name, valid=not why, reason=why)
        begin, count = 0, len(values) - len(self._sensors)
        for i, sensor in enumerate(self._sensors):
            added = message.sensor.add(name=sensor.name, reason=reasons[i] if reasons else "")
            for field, width in sensor.fields:
                added.field.add(name=field, value=values[begin : begin + width].tolist())
                begin += width
            added.time, added.fresh = float(values[count + i]), bool(fresh[i])
        return message

    def _by_protobuf(self, row: int, name: str, flies: bool) -> bytes:
        """Return as protobuf bytes, with reasons, the readings of a vehicle that has stopped (not ``flies``) or lacks a
        reading."""
        if flies:
            self._last_words.pop(row, None)
            why, reasons = "", self._missing_reasons(row)
        else:
            if row not in self._last_words:
                why = self._simulation.reasons[self._first + row]
                self._last_words[row] = why, self._missing_reasons(row)
            why, reasons = self._last_words[row]
        if self._quick:
            values, fresh = self._measured()
            return bytes(self._vehicle_message(name, values[row], fresh[row], why, reasons).SerializeToString())
        return self._with_pictures(row, name, why, reasons)

    def _missing_reasons(self, row: int) -> list[str]:
        """Return, for each sensor, why the reading of the vehicle at ``row`` is missing; "" where it is not."""
        readings = self._fleet_reading()[self._fleet.name]
        return [getattr(readings, sensor).reasons[row] for sensor in self._fleet.sensor_names]

    def _with_pictures(self, row: int, name: str, why: str, reasons: Sequence[str]) -> bytes:
        """Return the readings of a vehicle in a fleet with cameras as protobuf bytes; ``why``: reason that it
        stopped."""
        found = Readings.Vehicle(name=name, valid=not why, reason=why)
        readings = self._fleet_reading()[self._fleet.name]
        for sensor_name, reason in zip(self._fleet.sensor_names, reasons, strict=True):
            sensor = getattr(readings, sensor_name)
            added = found.sensor.add(name=sensor_name, reason=reason)
            for field in sensor.fields:
                added.field.add(name=field, value=np.asarray(getattr(sensor, field))[row].ravel().tolist())
            added.time, added.fresh = float(sensor.time_of_reading[row]), bool(sensor.fresh[row])
        return bytes(found.SerializeToString())
