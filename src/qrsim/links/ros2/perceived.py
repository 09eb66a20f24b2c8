"""What vehicles perceive around them, as topics: scans, ranges by radio, and neighbours.

The number of distances of such a sensor is its own, so these topics are no columns of ``numbers``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from qrsim.links.ros2.blank import stamped
from qrsim.links.ros2.frames import flu_of
from qrsim.links.ros2.names import base_link, beacon, neighbours_link, scan_link
from qrsim.links.ros2.topics import Topic
from qrsim.links.ros2.typestore import Types
from qrsim.links.ros2.variances import own
from qrsim.links.shared.around import NEIGHBOURS, RANGINGS, SCANS, first_of
from qrsim.links.shared.sight import delivery
from qrsim.models.sensors.ranging import Ranging
from qrsim.models.sensors.scan import FARTHEST, Scan, ray_angles
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet

SCAN, RANGE, POSES = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Range", "geometry_msgs/msg/PoseArray"


class Perceived:
    """The topics of scans, ranges and neighbours of a world, of the first sensor of each kind.

    Args:
        types: of the distribution.
        simulation: reset.
        namespaces: of the vehicles.
        add: adds a topic, and returns its number.
    """

    def __init__(self, types: Types, simulation: Simulation, namespaces: Sequence[str], add: Callable[[Topic], int]):
        self._types, self._simulation = types, simulation
        self._spaces, self._add = namespaces, add
        self._parts: list[tuple[Fleet, int, _Part]] = []
        first = 0
        for fleet in simulation.world.fleets:
            for kinds, part in ((SCANS, _Scans), (RANGINGS, _Ranges), (NEIGHBOURS, _Neighbours)):
                number = first_of(fleet, kinds)
                if number is not None:
                    rows = range(first, first + fleet.size)
                    self._parts.append((fleet, number, part(self, fleet.sensors[number], rows)))
            first += fleet.size

    def new(self) -> Iterator[tuple[int, bytes]]:
        """Yield (topic number, CDR message) for each lidar scan, range and neighbour list delivered at the present
        tick."""
        for fleet, number, part in self._parts:
            fresh, times = delivery(self._simulation, fleet, number)
            if any(fresh):
                reading = getattr(self._simulation.reading[fleet.name], fleet.sensor_names[number])
                for own_row, (now, time) in enumerate(zip(fresh, times, strict=True)):
                    if now:
                        yield from part.messages(reading, own_row, time)


class _Part:
    """The topics of one kind of sensor of a fleet."""

    def __init__(self, all: Perceived, sensor: Any, rows: range):
        self.types, self.sensor, self.rows = all._types, sensor, rows
        self.spaces = [all._spaces[row] for row in rows]
        self.everybody, self.add = all._spaces, all._add
        self.begin()

    def begin(self) -> None:
        """Add the sensor's topics for each vehicle of the fleet; nothing here, subclasses override it."""

    def messages(self, reading: object, row: int, time: float) -> Iterator[tuple[int, bytes]]:
        """Yield (topic number, CDR message) of the sensor's reading of the vehicle at ``row`` of the fleet; ``time``
        [s]."""
        raise NotImplementedError


class _Scans(_Part):
    def begin(self) -> None:
        """Add a LaserScan topic for each vehicle."""
        self._topics = [self.add(Topic(f"/{space}/scan", SCAN, "sensor")) for space in self.spaces]

    def messages(self, reading: Any, row: int, time: float) -> Iterator[tuple[int, bytes]]:
        """Yield (topic number, LaserScan) of the vehicle at ``row``, rays from right to left; infinity where nothing is
        hit (REP-117)."""
        sensor, message = self.sensor, stamped(self.types, SCAN, time, scan_link(self.spaces[row]))
        angles = ray_angles(sensor.rays, sensor.field_of_view_rad)
        message.angle_min, message.angle_max = -float(angles[-1]), -float(angles[0])
        message.angle_increment = sensor.field_of_view_rad / sensor.rays
        message.scan_time = sensor.period
        message.range_min, message.range_max = 0.0, FARTHEST
        if isinstance(sensor, Scan):
            message.range_min, message.range_max = own(sensor.range_min, row), own(sensor.range_max, row)
        ranges = np.asarray(reading.range, np.float32)[row, ::-1]
        message.ranges = np.where(np.isfinite(ranges), ranges, np.float32(np.inf))
        yield self._topics[row], self.types.encode(message)


class _Ranges(_Part):
    def begin(self) -> None:
        """Add a Range topic for each pair of a vehicle and a beacon or other vehicle to which it measures the range."""
        sensor = self.sensor
        beacons = 0 if sensor.beacon_ned is None else sensor.beacon_ned.x.shape[0]
        others = {"none": [], "fleet": self.spaces, "all": list(self.everybody)}[sensor.vehicles]
        self._topics: list[list[tuple[int, str]]] = []
        for space in self.spaces:
            names = [*(beacon(number) for number in range(beacons)), *others]
            self._topics.append(
                [
                    (-1 if name == space else self.add(Topic(f"/{space}/ranging/{name}", RANGE, "sensor")), name)
                    for name in names
                ]
            )

    def messages(self, reading: Any, row: int, time: float) -> Iterator[tuple[int, bytes]]:
        """Yield (topic number, Range message) for each range that the vehicle at ``row`` has measured."""
        parts = [part for part in (reading.beacon_range, reading.vehicle_range) if part is not None]
        ranges = np.concatenate([np.asarray(part, np.float64)[row] for part in parts])
        message = stamped(self.types, RANGE, time, base_link(self.spaces[row]))
        message.field_of_view = 2.0 * np.pi
        message.max_range = own(self.sensor.range_max, row) if isinstance(self.sensor, Ranging) else FARTHEST
        message.variance = own(self.sensor.noise_std, row) ** 2 if isinstance(self.sensor, Ranging) else 0.0
        for (topic, _), distance in zip(self._topics[row], ranges.tolist(), strict=True):
            if topic >= 0 and distance == distance:
                message.range = distance
                yield topic, self.types.encode(message)


class _Neighbours(_Part):
    def begin(self) -> None:
        """Add a topic of neighbours' positions for each vehicle."""
        self._topics = [self.add(Topic(f"/{space}/neighbours", POSES, "sensor")) for space in self.spaces]

    def messages(self, reading: Any, row: int, time: float) -> Iterator[tuple[int, bytes]]:
        """Yield (topic number, PoseArray) with the positions of the neighbours that the vehicle at ``row`` sees,
        nearest first."""
        places = flu_of(np.asarray(reading.position, np.float64)[row])
        message = stamped(self.types, POSES, time, neighbours_link(self.spaces[row]))
        point, turn, pose = (self.types[f"geometry_msgs/msg/{name}"] for name in ("Point", "Quaternion", "Pose"))
        seen = places[np.isfinite(places).all(axis=1)].tolist()
        message.poses = [pose(point(*place), turn(0.0, 0.0, 0.0, 1.0)) for place in seen]
        yield self._topics[row], self.types.encode(message)
