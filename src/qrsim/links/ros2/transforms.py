"""Transforms between frames: where vehicles believe to be, and where their sensors sit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.interface.arrays import quaternion_of
from qrsim.links.ros2 import Message
from qrsim.links.ros2 import numbers as n
from qrsim.links.ros2.blank import empty
from qrsim.links.ros2.frames import enu_of, flu_of
from qrsim.links.ros2.names import EARTH, MAP, base_link, beacon, gnss_link, neighbours_link, range_link, scan_link
from qrsim.links.ros2.template import Template
from qrsim.links.ros2.typestore import Types
from qrsim.links.shared.around import NEIGHBOURS, RANGINGS, SCANS
from qrsim.models.sensors.rangefinder import IdealRangefinder, Rangefinder
from qrsim.models.site import Site
from qrsim.world.state import Fleet, World

TYPE, ONE = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped"
_H = 0.5**0.5
_LEVEL = (0.0, 0.0, 0.0, 1.0)
# Turns of FLU axes (x, y, z, w) that bring x to where a rangefinder looks.
_LOOKS = {
    "forward": _LEVEL,
    "backward": (0.0, 0.0, 1.0, 0.0),
    "left": (0.0, 0.0, _H, _H),
    "right": (0.0, 0.0, -_H, _H),
    "down": (0.0, _H, 0.0, _H),
    "up": (0.0, -_H, 0.0, _H),
}
_PATHS = (
    "header.stamp.sec",
    "header.stamp.nanosec",
    "transform.translation.x",
    "transform.translation.y",
    "transform.translation.z",
    "transform.rotation.x",
    "transform.rotation.y",
    "transform.rotation.z",
    "transform.rotation.w",
)


class _Known:
    """The /tf message of vehicles whose poses are known.

    Args:
        types: of the distribution.
        names: namespaces of these vehicles.
    """

    def __init__(self, types: Types, names: Sequence[str]):
        template = Template(types, types[TYPE]([transform(types, MAP, base_link(name)) for name in names]))
        self._cdr = np.frombuffer(template.cdr, np.uint8).copy()
        begins = [[template.slot(f"transforms.{i}.{path}")[0] for path in _PATHS] for i in range(len(names))]
        # Stamps are 4 bytes each, of a pose all numbers 8; where the bytes of each vehicle lie.
        places = np.array(begins, np.intp).reshape(len(names), len(_PATHS), 1)
        self._stamps = (places[:, :2] + np.arange(4)).reshape(len(names), 8)
        self._poses = (places[:, 2:] + np.arange(8)).reshape(len(names), 56)

    def message(self, poses: NumpyArray, stamps: NumpyArray) -> bytes:
        """Return the encoded message of poses (k, 7), each position and quaternion, and stamps (k, 2): s, ns."""
        self._cdr[self._stamps] = stamps.astype("<u4").view(np.uint8)
        self._cdr[self._poses] = np.ascontiguousarray(poses, "<f8").view(np.uint8)
        return self._cdr.tobytes()


class Transforms:
    """Messages of /tf: from the map to each vehicle that knows where it is.

    Args:
        types: of the distribution.
        namespaces: of the vehicles.
    """

    def __init__(self, types: Types, namespaces: Sequence[str]):
        self._types, self._namespaces = types, namespaces
        # By which vehicles know.
        self._messages: dict[bytes, _Known] = {}

    def message(self, numbers: NumpyArray, stamps: NumpyArray) -> bytes:
        """Return the encoded /tf message from numbers (n, WIDTH), with the stamp (n, 2) of each vehicle (s, ns)."""
        poses = numbers[:, n.POSITION : n.ORIENTATION + 4]
        known = np.isfinite(poses).all(axis=1)
        key = known.tobytes()
        if key not in self._messages:
            names = [self._namespaces[row] for row in np.flatnonzero(known).tolist()]
            self._messages[key] = _Known(self._types, names)
        return self._messages[key].message(poses[known], stamps[known])


def transform(
    types: Types, parent: str, child: str, place: Sequence[float] = (0.0, 0.0, 0.0), turn: Sequence[float] = _LEVEL
) -> Message:
    """Return a transform message of a child frame in its parent: translation [m] and rotation (x, y, z, w)."""
    found = empty(types, ONE)
    found.header.frame_id, found.child_frame_id = parent, child
    found.transform.translation = types["geometry_msgs/msg/Vector3"](*map(float, place))
    found.transform.rotation = types["geometry_msgs/msg/Quaternion"](*map(float, turn))
    return found


def static_transforms(types: Types, world: World, namespaces: Sequence[str], site: Site) -> Message:
    """Return the message of /tf_static: map on the Earth (REP-105), beacons, and sensors that are fixed to vehicles."""
    found, rest = [on_earth(types, site), *_beacons(types, world)], iter(namespaces)
    for fleet in world.fleets:
        for _ in range(fleet.size):
            found += _vehicle_transforms(types, fleet, next(rest))
    return types[TYPE](found)


def on_earth(types: Types, site: Site) -> object:
    """Return the transform of the map (east, north, up) in the Earth-centred frame (ECEF of WGS-84)."""
    latitude, longitude = site.latitude_rad, site.longitude_rad
    # About z by the longitude and a quarter turn, which brings x to the east, then about x by the colatitude.
    about, tilt = 0.5 * (longitude + 0.5 * math.pi), 0.5 * (0.5 * math.pi - latitude)
    turn = (
        math.cos(about) * math.sin(tilt),
        math.sin(about) * math.sin(tilt),
        math.sin(about) * math.cos(tilt),
        math.cos(about) * math.cos(tilt),
    )
    return transform(types, EARTH, MAP, site.origin_ecef().tolist(), turn)


def _beacons(types: Types, world: World) -> list[object]:
    """Return the transforms from the map to each beacon to which a sensor measures ranges."""
    found: dict[str, object] = {}
    for sensor in (each for fleet in world.fleets for each in fleet.sensors):
        if isinstance(sensor, RANGINGS) and sensor.beacon_ned is not None:
            places = np.stack([np.asarray(axis, np.float64) for axis in sensor.beacon_ned.axes], axis=-1)
            for number, place in enumerate(enu_of(places).tolist()):
                found.setdefault(beacon(number), transform(types, MAP, beacon(number), place))
    return list(found.values())


def _vehicle_transforms(types: Types, fleet: Fleet, name: str) -> list[object]:
    """Return the static transforms from a vehicle's body frame to the frames of its sensors."""
    transforms: dict[str, object] = {}
    for number, sensor in enumerate(fleet.sensors):
        turn: Sequence[float] = _LEVEL
        if isinstance(sensor, Rangefinder | IdealRangefinder):
            child, turn = range_link(name), _LOOKS[sensor.axis]
        elif "gnss" in type(sensor).__module__:
            child = gnss_link(name)
        elif isinstance(sensor, SCANS):
            child = scan_link(name)
        elif isinstance(sensor, NEIGHBOURS):
            child = neighbours_link(name)
        else:
            continue
        fitting = fleet.fitting(number)
        if fitting is not None and fitting.attitude is not None and turn is _LEVEL:
            angles = np.array(
                [float(angle) for angle in (fitting.attitude.roll, fitting.attitude.pitch, fitting.attitude.yaw)]
            )
            w, x, y, z = quaternion_of(angles).tolist()
            turn = (x, -y, -z, w)
        place = (0.0, 0.0, 0.0)
        if fitting is not None and fitting.position_body is not None:
            place = tuple(flu_of(np.array([float(axis) for axis in fitting.position_body.axes])).tolist())
        transforms.setdefault(child, transform(types, base_link(name), child, place, turn))
    return list(transforms.values())
