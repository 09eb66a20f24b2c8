"""Landing: down to the ground, idle motors there, and when a vehicle has landed."""

from __future__ import annotations

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.contracts import Triple
from qrsim.links.mavlink.stack.craft import Craft

# Descent is slow below the second height over home, and slower than before below the first [m].
SLOWS_AT, SLOW_AT = 10.0, 5.0
# What is asked to come down so far [m] and moves slower than this [m/s] is held by the ground; idle motors do not hold
# what falls faster than the last [m/s].
HELD, HELD_SPEED, FALLS = 0.6, 0.25, 1.0
# At landing speed for so long [s] and so far above its path [m], it may have a foot on the ground. A vehicle that leans
# into a wind turns over that foot, so it is kept level, with a part of the throttle of a hover, as by PX4: its position
# control asks for no horizontal acceleration after ``ground_contact``.
STEADY, TOUCHED, RESTS = 3.0, 0.2, 0.8
# On the ground for so long with a descent asked for, the motors idle; for so long, it has landed [s].
IDLE_AFTER, LANDED_AFTER = 0.5, 1.0


class Touchdown:
    """Tells when a vehicle that is asked to come down has landed."""

    def __init__(self) -> None:
        self.since: float | None = None

    def clear(self) -> None:
        """Forget when the vehicle first touched the ground."""
        self.since = None

    def seconds(self, craft: Craft, wanted_z: float) -> float:
        """Return for how long [s] a vehicle commanded down to NED z ``wanted_z`` [m] has rested on the ground; 0 in the
        air."""
        seen = craft.seen
        speed = abs(seen.velocity_ned[2])
        held = wanted_z - seen.position_ned[2] > HELD and speed < HELD_SPEED
        idles = self.since is not None and seen.time - self.since >= IDLE_AFTER and speed < FALLS
        if not (seen.on_ground or held or idles):
            self.since = None
            return 0.0
        if self.since is None:
            self.since = seen.time
        return seen.time - self.since


class Descent:
    """The way down at one place."""

    def __init__(self) -> None:
        self.touchdown = Touchdown()
        self._slow_since: float | None = None

    def begin(self) -> None:
        """Forget the last descent, before a new one begins."""
        self.touchdown.clear()
        self._slow_since = None

    def fly(self, craft: Craft, place: Triple) -> tuple[Order | None, bool]:
        """Return the order to descend vertically at a position NED [m] in this tick, and whether the vehicle has
        landed.

        Args:
            craft: vehicle.
            place: above which it comes down [m]; its third number counts for nothing.
        """
        path = craft.path
        on = self.touchdown.seconds(craft, path.position[2])
        if on >= IDLE_AFTER:
            return craft.idle(), on >= LANDED_AFTER
        level, up, down = craft.speeds()
        slow = min(craft.parameters.values["MPC_LAND_SPEED"], down)
        height = craft.home_z - craft.seen.position_ned[2]
        share = min(max((height - SLOW_AT) / (SLOWS_AT - SLOW_AT), 0.0), 1.0)
        # Below the ground as far as it takes: what holds the vehicle then is the ground.
        goal = (place[0], place[1], path.position[2] + 10.0)
        order = craft.go(goal, (level, up, slow + share * (down - slow)))
        if on > 0.0 or self._touches(craft, share):
            return craft.lean(0.0, 0.0, RESTS * craft.facts.hover_throttle), False
        return order, False

    def _touches(self, craft: Craft, share: float) -> bool:
        """Return whether the vehicle may touch the ground: it has sunk at landing speed (``share`` 0) for a while, and
        lags its path.

        Where it is low the while is none. ``share``: 0 at landing speed, 1 at that of its faster descent.
        """
        seen = craft.seen
        if share > 0.0 or not craft.flies:
            self._slow_since = None
            return False
        if self._slow_since is None:
            self._slow_since = seen.time
        above, speed = craft.path.position[2] - seen.position_ned[2], abs(seen.velocity_ned[2])
        steady = 0.0 if craft.is_low else STEADY
        return seen.time - self._slow_since > steady and above > TOUCHED and speed < HELD_SPEED
