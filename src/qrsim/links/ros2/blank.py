"""Messages with nothing in them, and with what stays the same for a vehicle."""

from __future__ import annotations

from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from qrsim.core.arrays import NumpyArray
from qrsim.links.ros2 import Message
from qrsim.links.ros2.typestore import Types


def empty(types: Types, name: str) -> Message:
    """Return a new ROS message of a type, with numbers 0 and with empty texts and sequences."""
    return types[name](**{field: _default(types, description) for field, description in types.fields(name)})


def stamped(types: Types, name: str, time: float, frame: str = "") -> Message:
    """Return a new ROS message, empty except for its header: simulated time [s] and frame id."""
    message = empty(types, name)
    message.header.stamp.sec, message.header.stamp.nanosec = stamp_of(time)
    message.header.frame_id = frame
    return message


def _default(types: Types, description: Any) -> Any:
    """Return the default of a message field from rosbags' description: 0, False, "", [] or an array of zeros."""
    kind, content = description
    if kind == Nodetype.NAME:
        return empty(types, content)
    if kind == Nodetype.BASE:
        return {"string": "", "bool": False}.get(content[0], 0.0 if "float" in content[0] else 0)
    (element, base), count = content
    if kind == Nodetype.SEQUENCE:
        count = 0
    if element != Nodetype.BASE or base[0] == "string":
        return [_default(types, (element, base)) for _ in range(count)]
    return np.zeros(count, {"char": "uint8", "byte": "uint8"}.get(base[0], base[0]))


def stamps_of(times: list[float]) -> NumpyArray:
    """Return ``stamp_of`` of simulated times (n,) [s], as an array (n, 2) int64."""
    found = np.empty((len(times), 2), np.int64)
    # Mostly they are those of one sensor.
    found[...] = stamp_of(times[0]) if times.count(times[0]) == len(times) else list(map(stamp_of, times))
    return found


def stamp_of(time: float) -> tuple[int, int]:
    """Split a simulated time [s] into seconds and nanoseconds, as in a ROS stamp."""
    return divmod(round(time * 1e9), 1_000_000_000)
