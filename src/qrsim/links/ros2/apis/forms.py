"""Messages whose numbers alone change, made by templates, and numbers in the axes of ROS.

The rotations are for the three numbers of one vehicle, for which arrays (``links/shared/turning.py``) take ten times as
long.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from qrsim.links.mavlink.stack.contracts import Quadruple, Triple
from qrsim.links.mavlink.view import View
from qrsim.links.ros2.apis.contracts import Make
from qrsim.links.ros2.blank import empty, stamp_of
from qrsim.links.ros2.template import Template
from qrsim.links.ros2.topics import STAMP
from qrsim.links.ros2.typestore import Types
from qrsim.links.shared import sight as s

HALF_ROOT = 0.5**0.5
# Returns the numbers of a message, in the order of its paths; None where they are not known.
Numbers = Callable[[View], Sequence[float] | None]


def form(types: Types, name: str, paths: Sequence[str], numbers: Numbers, frame: str = "", **constants: object) -> Make:
    """Return a function from a vehicle to its encoded message, which fills the stamp, if the type has one, and the
    fields ``paths`` by ``numbers``.

    Args:
        types: of the distribution.
        name: of the type.
        paths: of the numbers (``template.Template.putter``).
        numbers: of a vehicle, one for each path and for each element of an array.
        frame: of the header.
        constants: values of fields that stay, "__" for the dot in their paths.
    """
    message = empty(types, name)
    stamped = "header" in dict(types.fields(name))
    if stamped:
        message.header.frame_id = frame
    for path, value in constants.items():
        *parents, last = path.split("__")
        owner = message
        for parent in parents:
            owner = getattr(owner, parent)
        setattr(owner, last, value)
    template = Template(types, message)
    put = template.putter(*(STAMP if stamped else ()), *paths)

    def make(view: View) -> bytes | None:
        """Return the encoded message of a vehicle, None where its numbers are unknown."""
        values = numbers(view)
        if values is None:
            return None
        put(*(stamp_of(view.seen.time) if stamped else ()), *values)
        return bytes(template.cdr)

    return make


def enu(ned: Triple) -> Triple:
    """Convert a vector from NED to ENU axes, or back, by the same swap of axes."""
    return ned[1], ned[0], -ned[2]


def flu(frd: Sequence[float]) -> Triple:
    """Convert a vector from FRD to FLU body axes, or back, by the same change of signs."""
    return frd[0], -frd[1], -frd[2]


def orientation(view: View) -> Quadruple:
    """Return the vehicle's estimated attitude as a quaternion (x, y, z, w) from FLU to ENU."""
    w, x, y, z = view.row[s.QUATERNION : s.QUATERNION + 4]
    return HALF_ROOT * (x + y), HALF_ROOT * (x - y), HALF_ROOT * (w - z), HALF_ROOT * (w + z)


def turned(quaternion: Sequence[float], vector: Sequence[float]) -> Triple:
    """Rotate a body-frame vector to the reference frame, by an attitude quaternion (x, y, z, w)."""
    i, j, k, w = quaternion
    x, y, z = vector
    a, b, c = 2.0 * (j * z - k * y), 2.0 * (k * x - i * z), 2.0 * (i * y - j * x)
    return x + w * a + j * c - k * b, y + w * b + k * a - i * c, z + w * c + i * b - j * a


def turned_back(quaternion: Sequence[float], vector: Sequence[float]) -> Triple:
    """Rotate a reference-frame vector to the body frame, by an attitude quaternion (x, y, z, w)."""
    i, j, k, w = quaternion
    return turned((-i, -j, -k, w), vector)


def ned_attitude(x: float, y: float, z: float, w: float) -> Quadruple:
    """Convert an attitude quaternion from FLU to ENU (x, y, z, w) to one from FRD to NED (w, x, y, z)."""
    return HALF_ROOT * (w + z), HALF_ROOT * (x + y), HALF_ROOT * (x - y), HALF_ROOT * (w - z)


def heading(q: Quadruple) -> float:
    """Return the yaw [rad] of an attitude quaternion (w, x, y, z)."""
    w, x, y, z = q
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
