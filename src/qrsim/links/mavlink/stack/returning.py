"""Return: climb, fly to home or the nearest rally point, descend, land."""

from __future__ import annotations

import math

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.contracts import Item, Triple
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.landing import Descent
from qrsim.links.mavlink.stack.plan import place_of

# A climb counts as done within this height, and the way as flown within this distance [m].
CLIMBED, ABOVE = 0.5, 1.0
# Below the ceiling of the area it keeps so far [m].
BELOW = 3.0


class Return:
    """The way back of one vehicle.

    Attributes:
        lands: whether it comes down by now.
    """

    def __init__(self) -> None:
        self.lands = False
        self._phase, self._place, self._top = "climb", (0.0, 0.0, 0.0), 0.0
        self._waits_since: float | None = None
        self._descent = Descent()

    def begin(self, craft: Craft, rally: tuple[Item, ...]) -> None:
        """Start a return: choose the nearest of home and rally points as its goal, and the return's height."""
        here, values = craft.seen.position_ned, craft.parameters.values
        places: list[Triple] = [craft.home.position_ned if craft.home else here]
        places += [place_of(item, craft, here) for item in rally]
        self._place = min(places, key=lambda place: math.hypot(place[0] - here[0], place[1] - here[1]))
        distance = math.hypot(self._place[0] - here[0], self._place[1] - here[1])
        height = values["RTL_RETURN_ALT"]
        if distance < values["RTL_MIN_DIST"]:
            # Near home it stays in a cone of 45 degrees.
            height = min(height, distance)
        # A rally point is as high as it says; a return lands below it.
        high = min(craft.home_z - height, self._place[2])
        self._top = min(here[2], max(high, craft.facts.z_min + BELOW))
        self._phase, self.lands, self._waits_since = "climb", False, None
        self._descent.begin()
        craft.begin_path()
        self._from = here

    def fly(self, craft: Craft) -> tuple[Order | None, bool]:
        """Fly the return for one tick (climb, fly, descend, land); return the order, and whether the vehicle has
        landed."""
        if not craft.flies and not self.lands:
            return craft.idle(), craft.seen.on_ground
        here, place = craft.seen.position_ned, self._place
        if self._phase == "climb":
            if here[2] - self._top < CLIMBED:
                self._phase = "fly"
            return craft.go((self._from[0], self._from[1], self._top)), False
        if self._phase == "fly":
            if math.hypot(place[0] - here[0], place[1] - here[1]) < ABOVE:
                self._phase = "descend"
            craft.head_to(place[0], place[1], 2.0)
            return craft.go((place[0], place[1], self._top)), False
        if self._phase == "descend":
            values = craft.parameters.values
            low = max(craft.home_z - values["RTL_DESCEND_ALT"], self._top)
            if low - here[2] < CLIMBED:
                now, wait = craft.seen.time, values["RTL_LAND_DELAY"]
                self._waits_since = now if self._waits_since is None else self._waits_since
                if 0.0 <= wait <= now - self._waits_since:
                    self._phase, self.lands = "land", True
            return craft.go((place[0], place[1], low)), False
        return self._descent.fly(craft, place)
