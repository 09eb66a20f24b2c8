"""The READINGS message of all sensors: written in place if all have readings, else by protobuf."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.interface.arrays import as_array, quaternion_of
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.framing import frame
from qrsim.links.reference.radio import heard_by_all
from qrsim.links.reference.readout import places_of, varint
from qrsim.models.gnss.receivers import GnssReading
from qrsim.models.sensors.attitude import AttitudeReading
from qrsim.models.sensors.camera import CameraReading
from qrsim.models.site import Site
from qrsim.simulation.simulation import Simulation

Derive = Callable[[NumpyArray], NumpyArray]
# Tags, all of fields of type bytes but the time (double) and valid (varint); see qrsim.proto.
_TYPE_READINGS = b"\x08\x6a"
_READINGS, _TIME, _VEHICLE = b"\xd2\x06", b"\x09", b"\x12"
_NAME, _VALID, _VEHICLE_REASON, _SENSOR = b"\x0a", b"\x10\x01", b"\x1a", b"\x22"
_FIELD, _SENSOR_REASON, _VALUES = b"\x12", b"\x1a", b"\x12"


def sensor_readings(simulation: Simulation) -> pb.Readings:
    """Return the protobuf message READINGS: every sensor's present reading, or the reason why it is missing."""
    reading, found = simulation.reading, pb.Readings(t=simulation.time)
    told = zip(simulation.vehicle_names, simulation.valid, simulation.reasons, heard_by_all(simulation), strict=True)
    for name, valid, reason, heard in told:
        found.vehicle.add(name=name, valid=bool(valid), reason=reason, heard=heard)
    first = 0
    for fleet in simulation.world.fleets:
        for sensor_name in fleet.sensor_names:
            sensor = getattr(reading[fleet.name], sensor_name)
            arrays = {field: getattr(sensor, field).reshape(fleet.size, -1).tolist() for field in sensor.fields}
            for i, reason in enumerate(sensor.reasons):
                added = found.vehicle[first + i].sensor.add(name=sensor_name, reason=reason)
                for field, rows in arrays.items():
                    added.field.add(name=field, value=rows[i])
        first += fleet.size
    return found


@dataclasses.dataclass(frozen=True)
class SensorPart:
    """Message parts of one sensor of the n vehicles of a fleet.

    Attributes:
        name: of the sensor.
        fields: name and width of each field.
        sources: where in the packed state (n, ...) the numbers of the fields are, one after the other, or what they are
            derived from, and by what.
    """

    name: str
    fields: list[tuple[str, int]]
    sources: list[tuple[NumpyArray, Derive | None]]

    def values(self, floats: NumpyArray) -> NumpyArray:
        """Return this sensor's numbers (n, V) for all vehicles, gathered from the packed state's float buffer."""
        found = []
        for places, derive in self.sources:
            numbers = floats.take(places)
            found.append(numbers if derive is None else derive(numbers))
        return np.concatenate(found, axis=1, dtype=np.float64)


class SensorReadout:
    """Writes READINGS of one simulation in place, while every vehicle flies and every sensor has a reading.

    To find out why one has none takes many times as long as to say what it says.
    """

    def __init__(self, simulation: Simulation):
        self._simulation = simulation
        places = places_of(simulation)
        self._codes = np.concatenate([fleet.violation.code for fleet in places.fleets])
        fleets = [
            [sensor_of(*named, simulation.site) for named in zip(fleet.sensor_names, state.readings, strict=True)]
            for fleet, state in zip(simulation.world.fleets, places.fleets, strict=True)
        ]
        # How many messages there are changes from tick to tick.
        silent = simulation.world.radio is None
        self._writable = silent and all(sensor is not None for sensors in fleets for sensor in sensors)
        if self._writable:
            self._lay_out(fleets)

    def frame(self) -> bytes | None:
        """Return the present READINGS message as framed bytes; None if it has to be encoded by protobuf."""
        floats, integers = self._simulation.packed[1]
        if not self._writable or np.count_nonzero(np.asarray(integers).take(self._codes)):
            return None
        floats = np.asarray(floats)
        values = [sensor.values(floats) for sensor in self._sensors]
        numbers = np.concatenate([np.zeros(0), *(part.ravel() for part in values)])
        if not np.isfinite(numbers).all():
            return None
        self._time[0] = self._simulation.time
        self._bytes[self._places] = numbers.view(np.uint8)
        return self._bytes.tobytes()

    def _lay_out(self, fleets: list[list[Any]]) -> None:
        """Write the parts of READINGS that never change into a buffer, and store the offsets of its numbers."""
        content = b""
        names = iter(self._simulation.vehicle_names)
        self._sensors = [sensor for sensors in fleets for sensor in sensors]
        offsets: list[list[int]] = []
        for fleet, sensors in zip(self._simulation.world.fleets, fleets, strict=True):
            of_sensors: list[list[int]] = [[] for _ in sensors]
            for _ in range(fleet.size):
                vehicle, inside = _blank_vehicle(next(names), sensors)
                content, at = _appended(content, _VEHICLE, vehicle)
                for mine, more in zip(of_sensors, inside, strict=True):
                    mine += [at + offset for offset in more]
            offsets += of_sensors
        body = _TIME + bytes(8) + content
        self._bytes = np.frombuffer(frame(_TYPE_READINGS + _READINGS + varint(len(body)) + body), np.uint8).copy()
        first = len(self._bytes) - len(content)
        self._time = np.ndarray((1,), "<f8", self._bytes, first - 8)
        numbers = np.array([offset for mine in offsets for offset in mine], int)
        self._places = (first + numbers[:, None] + np.arange(8)).ravel()


def _blank_vehicle(name: str, sensors: list[SensorPart]) -> tuple[bytes, list[list[int]]]:
    """Return a vehicle's encoded message with zeros for all numbers, and the byte offset of each sensor's numbers."""
    content = _encoded_text(_NAME, name) + _VALID + _encoded_text(_VEHICLE_REASON, "")
    found = []
    for sensor in sensors:
        inner, inside = _encoded_text(_NAME, sensor.name), []
        for field, width in sensor.fields:
            head = _encoded_text(_NAME, field) + _VALUES + varint(8 * width)
            inner, at = _appended(inner, _FIELD, head + bytes(8 * width))
            inside += [at + len(head) + 8 * i for i in range(width)]
        inner += _encoded_text(_SENSOR_REASON, "")
        content, at = _appended(content, _SENSOR, inner)
        found.append([at + offset for offset in inside])
    return content, found


def _appended(content: bytes, tag: bytes, inner: bytes) -> tuple[bytes, int]:
    """Append ``inner``, an encoded message, to ``content`` as the field with this tag; return the bytes, and the offset
    of ``inner``."""
    content += tag + varint(len(inner))
    return content + inner, len(content)


def _encoded_text(tag: bytes, text: str) -> bytes:
    """Encode a text as the protobuf field with this tag."""
    encoded = text.encode()
    return tag + varint(len(encoded)) + encoded


def sensor_of(name: str, reading: Any, site: Site) -> SensorPart | None:
    """Return the encoder of one sensor's readings; ``reading`` holds buffer indices in place of numbers. None for
    cameras."""
    if isinstance(reading, CameraReading):
        return None
    said = {field.name: getattr(reading, field.name) for field in dataclasses.fields(reading)}
    own = {name: as_array(value) for name, value in said.items() if value is not None}
    own = {field: places.reshape(len(places), -1) for field, places in own.items()}
    fields = [(field, places.shape[1]) for field, places in own.items()]
    sources: list[tuple[NumpyArray, Derive | None]] = [(np.concatenate(list(own.values()), axis=1), None)]
    if isinstance(reading, AttitudeReading):
        fields.append(("quaternion", 4))
        sources.append((own["attitude"], quaternion_of))
    if isinstance(reading, GnssReading):
        derived = ["latitude_deg", "longitude_deg", "height", *(() if "fix_type" in own else ("fix_type",))]
        fields += [(field, 1) for field in derived]

        def geodetic(position_ned: NumpyArray) -> NumpyArray:
            """Convert positions NED (n, 3) [m] to latitude, longitude [deg], height [m] and fix type, as far as the
            sensor has these columns."""
            latitude, longitude, height = site.ned_to_geodetic(position_ned)
            # Who has a position has a fix of three dimensions.
            columns = [np.degrees(latitude), np.degrees(longitude), height, np.full_like(height, 3.0)]
            return np.stack(columns[: len(derived)], axis=1)

        sources.append((own["position_ned"], geodetic))
    return SensorPart(name, fields, sources)
