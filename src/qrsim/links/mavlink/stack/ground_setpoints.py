"""Set-points of rovers: places and velocities on the ground; heights and headings do not count."""

from __future__ import annotations

import math

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.contracts import GlobalTarget, LocalTarget, Triple
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.offboard import Offboard


class GroundOffboard(Offboard):
    """The set-point of one rover."""

    def _take_motion(
        self, target: LocalTarget | GlobalTarget, position: Triple, velocity: Triple, acceleration: Triple
    ) -> str:
        """Store a set-point of position, velocity or acceleration without its vertical part; return "", or why it is
        refused."""
        # On the ground no height is needed.
        place, speeds = (position[0], position[1], 0.0), (velocity[0], velocity[1], 0.0)
        whole = any(all(map(math.isfinite, part)) for part in (place, speeds))
        # What is too large or missing altogether has a reason of its own.
        missing = any(all(math.isnan(part[axis]) for part in (place, speeds, acceleration)) for axis in (0, 1))
        if not whole and not missing:
            return "a rover needs a place or a velocity, of both axes"
        return super()._take_motion(target, place, speeds, acceleration)

    def _take_attitude(self, target: object, craft: Craft) -> str:
        """Refuse an attitude set-point, which a ground vehicle cannot follow; return the reason."""
        return "a rover has no attitude to fly"

    def fly(self, craft: Craft) -> tuple[Order | None, bool]:
        """Return the order that follows the last set-point, and False, since a ground vehicle never lands."""
        (north, east, _), (vn, ve, _) = self._position, self._velocity
        level = craft.speeds()[0]
        speed = math.hypot(vn, ve)
        if not math.isfinite(speed):
            return stop_at(craft, (north, east, 0.0)), False
        ratio = min(1.0, level / speed) if speed > 0.0 else 1.0
        vn, ve = ratio * vn, ratio * ve
        if math.isfinite(north + east):
            return craft.follow((north, east, craft.seen.position_ned[2]), (vn, ve, 0.0)), False
        return craft.fly((vn, ve, 0.0)), False


def stop_at(craft: Craft, place: Triple) -> Order:
    """Return the order to drive to a position NED [m], whose height is ignored, and to stop there."""
    goal = (place[0], place[1], craft.seen.position_ned[2])
    return Order(craft.facts.name, "track", (*goal, *goal, 0.0, craft.speeds()[0], 1.0))
