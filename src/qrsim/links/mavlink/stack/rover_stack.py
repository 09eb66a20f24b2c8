"""The flight stack of a rover: it stands, and drives missions, set-points and home; it neither takes off nor lands."""

from __future__ import annotations

import math
from collections.abc import Sequence

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack import plan
from qrsim.links.mavlink.stack.codes import PlanResult, Result, Severity
from qrsim.links.mavlink.stack.contracts import Ack, Command, Item, Seen, Triple
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.stack.ground_setpoints import GroundOffboard, stop_at
from qrsim.links.mavlink.stack.mission import Mission
from qrsim.links.mavlink.stack.modes import ROVER_FLAVOURS, Mode
from qrsim.scenarios.plans import commands as known

# Land, take off, orbit, turn on the spot.
REFUSED = frozenset((21, 22, 34, 115))
# Items that need height, or circles.
UNSUPPORTED = frozenset((known.LOITER_TURNS, known.LAND, known.TAKEOFF, known.LOITER_TO_ALTITUDE))


class Drive(Mission):
    """A mission on the ground: heights of items do not count."""

    def accept(self, items: Sequence[Item], craft: Craft) -> tuple[PlanResult, int]:
        """Replace the mission, unless an item is invalid; return the result, and the invalid item's sequence number or
        -1."""
        for index, item in enumerate(items):
            if item.command in UNSUPPORTED:
                return PlanResult.UNSUPPORTED, index
        return super().accept(items, craft)

    def _stay(self, craft: Craft) -> Order | None:
        """Return None, which keeps the last order: a rover stops by itself at the end of its path."""
        return None

    def _go(self, item: Item, craft: Craft) -> tuple[bool, Order | None]:
        """Drive to an item's position and wait its hold time; return whether that is done, and the order (None: stand
        still)."""
        here, now = craft.seen.position_ned, craft.seen.time
        if self._goal is None:
            self._goal = plan.place_of(item, craft, self._from or here)
        radius = item.params[1] if item.command == known.WAYPOINT and item.params[1] > 0.0 else 0.0
        radius = radius or craft.parameters["NAV_ACC_RAD"]
        if self._arrived is None and away(craft, self._goal) < radius:
            self._arrived = now
        if self._arrived is not None:
            return now - self._arrived >= self._hold(item), None
        goes_on = self._hold(item) == 0.0 and self.current + 1 < len(self.items)
        return False, drive(craft, self._goal, 0.5 * radius if goes_on else 0.0)


class RoverStack(FlightStack):
    """See ``contracts.Stack``; the arguments are those of ``FlightStack``."""

    _flavours = ROVER_FLAVOURS
    _plan = Drive

    def reset(self) -> None:
        """Restart the rover's flight stack as after a boot: disarmed, time 0."""
        super().reset()
        self._stands, self.offboard = False, GroundOffboard()
        self.offboard.keeps_places = self.flavour.name == "ardupilot"

    def tick(self, seen: Seen) -> Order | None:
        """Advance by one tick with the vehicle's present state; return its new order, or None to keep the last one."""
        craft = self.craft
        seen.on_ground = True
        craft.look(seen)
        # What is looked at in flight, the fence for example, is looked at while it is armed.
        craft.flies = self.armed
        self.checks.look(craft)
        if craft.home is None and seen.valid and seen.fix_type >= 3:
            craft.home_here()
        if self.armed and seen.stopped:
            craft.say(Severity.EMERGENCY, f"Run has ended: {seen.stopped}")
            self.disarm("")
        if self.armed:
            asked = self.failsafes.look(craft, self.mode, self.offboard, self.factor)
            if asked:
                self._fail_over(asked)
        order = self._drive() if self.armed and seen.valid else None
        if order is not None:
            self._stands = False
            return order
        return self._stand()

    def _stand(self) -> Order | None:
        """Return the order to stop at the first call; later None, which keeps it."""
        if self._stands:
            return None
        self._stands = True
        return Order(self.facts.name, "velocity", (0.0, 0.0, 0.0, 0.0))

    def _drive(self) -> Order | None:
        """Return the order of the present flight mode; None: stand still."""
        craft = self.craft
        if self.mode is Mode.MISSION:
            order, over = self.plan.fly(craft)
            if over and self.plan.returns:
                self.switch(Mode.RTL)
            elif over:
                craft.say(Severity.INFO, "Mission finished, holding")
                self.switch(Mode.HOLD)
            return order
        if self.mode is Mode.OFFBOARD:
            return self.offboard.fly(craft)[0]
        if self.mode is Mode.HOLD and self._goal is not None:
            return stop_at(craft, self._goal)
        if self.mode is Mode.RTL and craft.home is not None:
            if away(craft, craft.home.position_ned) >= self.parameters["NAV_ACC_RAD"]:
                return drive(craft, craft.home.position_ned)
            self.switch(Mode.HOLD)
        return None

    def arm(self, force: bool = False) -> Result:
        """Arm the rover, or send clients the reasons against it and return the refusal; ``force`` skips the checks."""
        result = super().arm(force)
        # There is nothing to take off for.
        self.craft.flies = self.armed
        return result

    def command(self, command: Command) -> Ack:
        """Execute or refuse a command, with the limits of a ground vehicle."""
        if command.id not in REFUSED:
            return super().command(command)
        self._refuse(f"Command {command.id}", "a rover cannot")
        return Ack(Result.DENIED)

    def request(self, mode: Mode) -> Result:
        """Change to a flight mode for a client, or send clients the reason against it and return the refusal."""
        if mode in self.flavour.modes or mode is Mode.GUIDED:
            return super().request(mode)
        self._refuse("Mode", f"a rover has no {mode.value}")
        return Result.DENIED

    def switch(self, mode: Mode, goal: Triple | None = None) -> None:
        """Change the flight mode without checks; a mode that a rover lacks becomes HOLD."""
        if mode in self.flavour.modes:
            super().switch(mode, goal)
        else:
            super().switch(Mode.HOLD)


def away(craft: Craft, place: Triple) -> float:
    """Return the horizontal distance [m] from the vehicle to a position NED [m]."""
    here = craft.seen.position_ned
    return math.hypot(place[0] - here[0], place[1] - here[1])


def drive(craft: Craft, place: Triple, beyond: float = 0.0) -> Order:
    """Return the order to drive to a position NED [m], whose height is ignored; ``beyond``: as in ``Craft.go``."""
    return craft.go((place[0], place[1], craft.seen.position_ned[2]), beyond=beyond)
