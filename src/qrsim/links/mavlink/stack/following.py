"""Follow-me: flight next to a target that reports its position."""

from __future__ import annotations

import math

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.contracts import FollowTarget, Triple
from qrsim.links.mavlink.stack.craft import Craft

# As PX4's FlightTaskAutoFollowTarget and its estimator: after so long without a message the target stands [s]; it has a
# course from this speed on [m/s]; sideways it moves within the first of its height, not below the second over home, and
# looks at a target farther than the third [m].
STALE_AFTER, HAS_COURSE, ON_HEIGHT, LOWEST, LOOKS_FROM = 3.0, 1.0, 3.0, 1.0, 1.0
# FLW_TGT_ALT_M: over the target's own height; all others are over home, for the ground is flat.
TRACKS_HEIGHT = 2


class Follow:
    """The target of one vehicle, and where it is seen from."""

    def __init__(self) -> None:
        self._place: Triple | None = None
        self._velocity: Triple = (0.0, 0.0, 0.0)
        self._heard = self._course = 0.0
        self._angle: float | None = None
        self._goal: Triple | None = None

    def take(self, target: FollowTarget, craft: Craft) -> None:
        """Store the target's position and velocity from a FOLLOW_TARGET message; messages with invalid numbers are
        ignored."""
        numbers = (target.latitude, target.longitude, target.altitude, *target.velocity)
        if not all(map(math.isfinite, numbers)) or abs(target.altitude) > 1e5 or max(map(abs, target.velocity)) > 1e3:
            return
        self._place = craft.geodesy.to_ned(target.latitude, target.longitude, target.altitude)
        self._velocity, self._heard = target.velocity, craft.seen.time

    def begin(self, craft: Craft) -> None:
        """Start the follow-me mode: brake to a stop until the target's position arrives."""
        craft.begin_path()
        self._angle = None
        self._goal = craft.path.stop(craft.parameters["MPC_ACC_HOR"])

    def fly(self, craft: Craft, stretch: float) -> Order | None:
        """Return the order to follow the target; ``stretch``: simulated seconds per second of the target's clock."""
        here, values, dt = craft.seen.position_ned, craft.parameters.values, craft.facts.time_step
        if self._place is None:
            return craft.go(self._goal or here) if craft.flies else craft.idle()
        age = craft.seen.time - self._heard
        moves = 0.0 <= age < STALE_AFTER * stretch
        vn, ve, vd = self._velocity if moves else (0.0, 0.0, 0.0)
        target = (self._place[0] + age * vn, self._place[1] + age * ve, self._place[2] + age * vd)
        if math.hypot(vn, ve) >= HAS_COURSE:
            self._course = math.atan2(ve, vn)
        distance = values["FLW_TGT_DST"]
        if self._angle is None:
            self._angle = math.atan2(here[1] - target[1], here[0] - target[0])
        # Round the target it flies no faster than this.
        step = values["FLW_TGT_MAX_VEL"] / distance * dt
        wanted = self._course + math.radians(values["FLW_TGT_FA"])
        self._angle += min(max(math.remainder(wanted - self._angle, 2.0 * math.pi), -step), step)
        base = target[2] if int(values["FLW_TGT_ALT_M"]) == TRACKS_HEIGHT else craft.home_z
        z = min(base - values["FLW_TGT_HT"], craft.home_z - LOWEST)
        goal = (target[0] + distance * math.cos(self._angle), target[1] + distance * math.sin(self._angle), z)
        along: Triple = (vn, ve, 0.0)
        if abs(z - here[2]) >= ON_HEIGHT:
            # First up or down.
            goal, along = (craft.path.position[0], craft.path.position[1], z), (0.0, 0.0, 0.0)
        craft.look_to(target[0], target[1], LOOKS_FROM)
        _, up, down = craft.speeds()
        return craft.go(goal, (min(values["MPC_XY_VEL_MAX"], craft.facts.speed_limit), up, down), along=along)
