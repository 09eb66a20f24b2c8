"""Mission: the items of a plan flown one after the other."""

from __future__ import annotations

import math
from collections.abc import Sequence

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack import plan
from qrsim.links.mavlink.stack.circling import Circle, edge, turn_radius
from qrsim.links.mavlink.stack.codes import MissionState, PlanResult, Severity
from qrsim.links.mavlink.stack.contracts import FlavourName, Item, Triple
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.landing import Descent
from qrsim.links.mavlink.stack.path import BRAKING, approach
from qrsim.links.mavlink.stack.statuses import MissionStatus
from qrsim.links.mavlink.stack.ways import Way, way_to
from qrsim.scenarios.plans import commands as known

# An item's height counts as reached within this [m], as NAV_MC_ALT_RAD.
HEIGHT_RADIUS = 0.8
# A circle begins within this of its edge, and a take-off elsewhere is flown to from above [m].
EDGE, ELSEWHERE = 1.0, 1.0
# A jump with this many repeats has no end.
FOR_EVER = -1.0
# A mission ends after so many jumps without an item that is flown: AP_Mission passes as many DO items, and PX4's
# MissionBase gives up after 10 jumps to jumps.
MOST_JUMPS = 255


class Mission:
    """The plan of one vehicle, and how far it is with it.

    Args:
        flavour: "px4" or "ardupilot", which keeps home in item 0 and reads no heading from places.

    Attributes:
        items: as accepted.
        current: seq of the item that is flown.
        state: of it.
        returns: whether the item that was reached last asks for a return.
        landed: whether the mission ended on the ground.
        rises, lands: whether the item that is flown takes off or comes down.
        descent: of a landing.
    """

    def __init__(self, flavour: FlavourName = "px4") -> None:
        self._flavour = flavour
        # Seq of the first item that is flown.
        self._first = 1 if flavour == "ardupilot" else 0
        self.items: tuple[Item, ...] = ()
        self.current = 0
        self.state = MissionState.NO_MISSION
        self.returns = self.landed = self.rises = self.lands = False
        self._jumps: dict[int, int] = {}
        self._cycles = 0
        # A heading that a CONDITION_YAW asked for, until the next place is over [rad].
        self._heading: float | None = None
        self.descent = Descent()
        self._forget()

    def _forget(self) -> None:
        """Forget the progress within the current mission item."""
        self._goal: Triple | None = None
        self._way = Way()
        self._from: Triple | None = None
        self._arrived: float | None = None
        self._turns, self._centre_ned = Circle(), (0.0, 0.0, 0.0)
        self._lifted = self._away = False
        self._top = 0.0
        self.rises = self.lands = False
        self.descent.begin()

    # ---- the plan ----

    def accept(self, items: Sequence[Item], craft: Craft) -> tuple[PlanResult, int]:
        """Replace the mission, unless an item is invalid; return the result, and that item's sequence number or -1."""
        result, bad = plan.check(items, self._flavour)
        if result is not PlanResult.ACCEPTED:
            return result, bad
        self.items = tuple(items)
        self.restart(craft)
        self.why_not(craft)
        return result, -1

    def why_not(self, craft: Craft) -> str:
        """Return why the mission cannot be flown, and warn clients; "" if it can."""
        why = "no mission" if not self.items else ""
        seq = self._outside(craft)
        if seq is not None:
            why = f"item {seq} is outside the fence"
        if why and self.items:
            craft.say(Severity.CRITICAL, f"Mission rejected: {why}")
        return why

    def _outside(self, craft: Craft) -> int | None:
        """Return the sequence number of the first item outside the fence or flight area; None if all are inside."""
        return plan.outside(self.items, craft)

    def status(self, in_mode: bool) -> MissionStatus:
        """Return the fields of MISSION_CURRENT; ``in_mode``: the vehicle is in the mode MISSION."""
        return MissionStatus(self.current, len(self.items), self.state, in_mode)

    def set_current(self, seq: int, craft: Craft, reset: bool = False) -> bool:
        """Make item ``seq`` the current one, ``reset``: with jump counters cleared; return whether it exists.

        An item before the first that is flown stands for the whole plan, as with ArduPilot.

        Args:
            seq: of the item; -1: go on with the present one.
            craft: that is told.
            reset: whether jumps count from zero again, and a mission that was completed can go on.
        """
        if not -1 <= seq < len(self.items) or not self.items:
            return False
        reset = reset or -1 < seq < self._first
        if reset or self.state is MissionState.COMPLETE:
            self._jumps.clear()
        if self.state is MissionState.COMPLETE and (reset or seq >= 0):
            self.state = MissionState.PAUSED
        if seq >= 0:
            self._go_to(min(max(seq, self._first), len(self.items) - 1))
        craft.tell("mission")
        return True

    def restart(self, craft: Craft) -> None:
        """Make the first item the current one, with the mission's state NOT_STARTED."""
        self._start_at(min(self._first, max(0, len(self.items) - 1)))
        self.state = MissionState.NOT_STARTED if self.items else MissionState.NO_MISSION
        craft.tell("mission")

    def _start_at(self, seq: int) -> None:
        """Make the item with sequence number ``seq`` the current one, and reset all jump counters."""
        self._jumps.clear()
        self._go_to(seq)

    def _go_to(self, seq: int) -> None:
        """Make item ``seq`` the current one, and forget how the last one was flown."""
        self.current = seq
        self._heading = None
        self._forget()

    # ---- flight ----

    def begin(self, craft: Craft) -> None:
        """Start or resume the mission; a completed one starts from its first item."""
        if self.state is MissionState.COMPLETE or self.current >= len(self.items):
            self._start_at(min(self._first, max(0, len(self.items) - 1)))
        self._forget()
        self.state, self.returns, self.landed = MissionState.ACTIVE, False, False
        craft.begin_path()
        craft.tell("mission")

    def pause(self, craft: Craft) -> None:
        """Note that the vehicle no longer flies the mission."""
        if self.state is MissionState.ACTIVE:
            self.state = MissionState.PAUSED
            craft.tell("mission")

    def fly(self, craft: Craft) -> tuple[Order | None, bool]:
        """Fly the mission for one tick; return the order (None: keep the last one), and whether the mission is over."""
        # Items without a place take no time, but two of them may jump to each other.
        for _ in range(len(self.items)):
            item = self.items[self.current]
            done, order = self._fly_item(item, craft)
            if not done or order is not None:
                self._cycles = 0
            if not done:
                return order, False
            over = self._next(item, craft)
            if over or order is not None:
                return order, over
        return None, False

    def _next(self, item: Item, craft: Craft) -> bool:
        """Advance to the next item, following jumps; return whether the mission is over."""
        craft.tell("item_reached", self.current)
        self.returns = item.command == known.RETURN
        following = self.current + 1
        if item.command == known.JUMP:
            jumped, times = self._jumps.get(self.current, 0), item.params[1]
            if times == FOR_EVER or jumped < times:
                self._jumps[self.current] = jumped + 1
                self._cycles += 1
                following = int(item.params[0])
        over = following >= len(self.items) or self.returns
        if self._cycles > MOST_JUMPS:
            craft.say(Severity.CRITICAL, "DO JUMP is cycling, giving up")
            over, self._cycles = True, 0
        if over:
            self.state = MissionState.COMPLETE
            self.landed = item.command == known.LAND
        else:
            if item.command in known.PLACES:
                self._heading = None
            # Items without a place leave the line to the next one as it is; a circle ends anywhere on it.
            before = self._from if item.command in plan.ON_THE_WAY or self._goal is None else self._goal
            if item.command == known.LOITER_TURNS:
                before = craft.path.position
            self.current = following
            self._forget()
            self._from = before
        craft.tell("mission")
        return over

    def _fly_item(self, item: Item, craft: Craft) -> tuple[bool, Order | None]:
        """Fly or execute an item for one tick; return whether it is done, and the order (None: keep the last one)."""
        command, params, now = item.command, item.params, craft.seen.time
        if command == known.LAND:
            return self._land(item, craft)
        if command == known.TAKEOFF:
            return self._take_off(item, craft)
        if command in known.PLACES:
            return self._go(item, craft)
        if command in (known.DELAY, known.CONDITION_DELAY):
            self._arrived = now if self._arrived is None else self._arrived
            wait = params[0] if params[0] > 0.0 else 0.0
            return now - self._arrived >= wait, self._stay(craft)
        if command in plan.ON_THE_WAY:
            return self._on_the_way(item, craft)
        if command == known.CHANGE_SPEED:
            change_speed(craft, params[0], params[1])
        elif command == known.SET_HOME:
            plan.set_home(item, craft)
        elif command == known.CONDITION_YAW:
            self._heading = heading(craft, params[0], params[2], params[3])
        return True, None

    def _on_the_way(self, item: Item, craft: Craft) -> tuple[bool, Order | None]:
        """Fly on until this item's condition (distance or gate) holds; return whether it does, and the order.

        A gate is the plane through its place across the way from there to the next one, as in PX4's MissionBlock.
        """
        following = plan.next_place(self.items[self.current + 1 :])
        if following is None or not craft.flies:
            return True, None
        _, order = self._go(following, craft)
        here, goal = craft.seen.position_ned, self._goal
        if self._arrived is not None or goal is None:
            return True, order
        if item.command == known.CONDITION_DISTANCE:
            return math.dist(here[:2], goal[:2]) < item.params[0], order
        gate = plan.place_of(item, craft, here)
        north, east = goal[0] - gate[0], goal[1] - gate[1]
        return (here[0] - gate[0]) * north + (here[1] - gate[1]) * east >= 0.0, order

    def _turns_to(self, item: Item) -> float:
        """Return the heading [rad] that the mission requires on the way to an item; NaN without one."""
        if self._heading is not None:
            return self._heading
        asks = self._flavour == "px4" and item.command in (known.WAYPOINT, known.TAKEOFF)
        return math.radians(item.params[3]) if asks else math.nan

    def _stay(self, craft: Craft) -> Order | None:
        """Return the order to hold the position; on the ground, to keep the motors off."""
        if not craft.flies and craft.seen.on_ground:
            return craft.idle()
        if self._goal is None:
            self._goal = self._from or craft.path.stop(craft.parameters["MPC_ACC_HOR"])
        return craft.go(self._goal)

    def _take_off(self, item: Item, craft: Craft) -> tuple[bool, Order | None]:
        """Climb to the item's height, and fly on to its position (PX4); return whether that is done, and the order."""
        if self._away:
            return self._go(item, craft)
        self.rises = True
        here = craft.seen.position_ned
        if self._goal is None:
            height = craft.home_z - craft.parameters["MIS_TAKEOFF_ALT"]
            goal = plan.place_of(item, craft, (here[0], here[1], height))
            self._goal = (here[0], here[1], min(goal[2], here[2]))
        if math.isfinite(turn := self._turns_to(item)) and craft.flies:
            craft.turn_to(turn)
        level, up, down = craft.speeds()
        order = craft.go(self._goal, (level, min(up, craft.parameters["MPC_TKO_SPEED"]), down))
        risen = here[2] - self._goal[2] < HEIGHT_RADIUS
        if risen and self._flavour == "px4" and plan.has_place(item):
            # PX4 flies on to the place of a take-off; ArduPilot's Copter takes nothing but its altitude.
            place = plan.place_of(item, craft, self._goal)
            if math.dist(place[:2], self._goal[:2]) > ELSEWHERE:
                self._from, self._goal, self._away, self.rises = self._goal, None, True, False
                return self._go(item, craft)
        return risen, order

    def _go(self, item: Item, craft: Craft) -> tuple[bool, Order | None]:
        """Fly to an item's position and hold there; return whether the item is done, and the order."""
        here, now = craft.seen.position_ned, craft.seen.time
        if self._goal is None:
            self._goal = plan.place_of(item, craft, self._from or here)
            if item.command == known.LOITER_TURNS:
                self._centre_ned, self._goal = self._goal, edge(self._goal, self._from or here, turn_radius(item))
            # From the ground it rises to the height of its first item, at least to that of a take-off.
            self._top = min(self._goal[2], craft.home_z - craft.parameters["MIS_TAKEOFF_ALT"])
            self._lifted = craft.flies
            begin = self._from if self._lifted else (here[0], here[1], self._top)
            self._way = way_to(self.items, item, begin, self._goal, craft)
        goal, top = self._goal, self._top
        if not self._lifted:
            self._lifted = here[2] - top < HEIGHT_RADIUS
            self.rises = not self._lifted
            level, up, down = craft.speeds()
            return False, craft.go((here[0], here[1], top), (level, min(up, craft.parameters["MPC_TKO_SPEED"]), down))
        radius = item.params[1] if item.command == known.WAYPOINT and item.params[1] > 0.0 else 0.0
        radius = radius or craft.parameters["NAV_ACC_RAD"]
        if bend := self._way.through(here, radius):
            return False, self._pass_through(item, craft, *bend)
        if math.isfinite(turn := self._turns_to(item)):
            craft.turn_to(turn)
            turns = False
        else:
            turns = self._arrived is None and craft.head_to(goal[0], goal[1], radius)
        away = math.hypot(goal[0] - here[0], goal[1] - here[1])
        circles = item.command == known.LOITER_TURNS
        # In gusts the vehicle may stay farther from the edge than its path.
        at_edge = away < EDGE or math.dist(craft.path.position, goal) < 0.5 * EDGE
        near = away < radius and (at_edge or not circles) and abs(goal[2] - here[2]) < HEIGHT_RADIUS
        if circles and (near or self._arrived is not None):
            return self._circle(item, craft, self._centre_ned)
        if near and self._arrived is None:
            self._arrived = now
        hold = self._hold(item)
        if turns:
            _, up, down = craft.speeds()
            return False, craft.go(goal, (0.0, up, down))
        beyond = 0.0 if circles or hold > 0.0 or self.current + 1 >= len(self.items) else self._way.beyond_goal(radius)
        order = craft.go(goal, beyond=beyond, begin=self._way.begin)
        return self._arrived is not None and now - self._arrived >= hold, order

    def _pass_through(self, item: Item, craft: Craft, place: Triple, onward: float) -> Order:
        """Return the order to pass a waypoint without stopping, as if the path went straight on for ``onward`` [m]."""
        if math.isfinite(turn := self._turns_to(item)):
            craft.turn_to(turn)
        else:
            craft.head_to(place[0], place[1], 1.0)
        return craft.go(place, beyond=onward, begin=self._way.begin)

    @staticmethod
    def _hold(item: Item) -> float:
        """Return the time [s] to hold position at an item: infinite for LOITER_UNLIM, 0 for items without a hold."""
        if item.command == known.LOITER_FOREVER:
            return math.inf
        timed = item.command in known.WAYPOINTS or item.command == known.LOITER_TIME
        return item.params[0] if timed and item.params[0] > 0.0 else 0.0

    def _circle(self, item: Item, craft: Craft, centre: Triple) -> tuple[bool, Order | None]:
        """Fly the item's turns around a centre NED [m]; return whether they are complete, and the order."""
        radius, turns = turn_radius(item), self._turns
        if self._arrived is None:
            self._arrived = craft.seen.time
            turns.begin(craft, centre)
        done = turns.turned >= 2.0 * math.pi * item.params[0]
        craft.yaw = turns.tangent(radius)
        most = craft.parameters["MPC_ACC_HOR"]
        # Slow at the end, as the next line begins in any direction.
        left = EDGE + max(2.0 * math.pi * item.params[0] - turns.turned, 0.0) * abs(radius)
        speed = min(craft.speeds()[0], math.sqrt(0.5 * most * abs(radius)), approach(left, BRAKING * most))
        order, moves = turns.fly(craft, centre, radius, speed)
        return done and moves, order

    def _land(self, item: Item, craft: Craft) -> tuple[bool, Order | None]:
        """Fly to the item's position and descend; return whether the vehicle has landed, and the order."""
        here = craft.seen.position_ned
        if self._goal is None:
            place = plan.place_of(item, craft, self._from or here)
            self._goal = (place[0], place[1], here[2])
        if not self.lands:
            goal = (self._goal[0], self._goal[1], self._goal[2])
            if math.hypot(goal[0] - here[0], goal[1] - here[1]) > max(1.0, 0.5 * craft.parameters["NAV_ACC_RAD"]):
                craft.head_to(goal[0], goal[1], 2.0)
                return False, craft.go(goal, begin=self._from)
            self.lands = True
        order, landed = self.descent.fly(craft, self._goal)
        return landed, order


def heading(craft: Craft, angle: float, direction: float, relative: float) -> float:
    """Return the heading [rad] of CONDITION_YAW: an angle [deg], absolute or relative (to the left: direction < 0)."""
    turn = math.radians(angle)
    if not relative > 0.0:
        return turn
    return craft.yaw + (-turn if direction < 0.0 else turn)


def change_speed(craft: Craft, kind: float, speed: float) -> bool:
    """Obey DO_CHANGE_SPEED; kind 0, 1: horizontal, 2: climb, 3: descent; speed [m/s], -1: unchanged, -2: default.

    Return whether it can be obeyed.
    """
    if kind not in (0.0, 1.0, 2.0, 3.0) or not (speed in (-1.0, -2.0) or 0.0 < speed < math.inf):
        return False
    if speed == -1.0:
        return True
    wanted = None if speed == -2.0 else speed
    if kind in (0.0, 1.0):
        craft.cruise = wanted
    elif kind == 2.0:
        craft.climb = wanted
    else:
        craft.sink = wanted
    return True
