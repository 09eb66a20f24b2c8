"""What all parts of one vehicle's stack share: what it sees, where it is going, and what it says."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.codes import GROUND_ROVER, Landed, Result, Severity
from qrsim.links.mavlink.stack.contracts import Event, EventKind, Facts, Home, Seen, Text, Triple
from qrsim.links.mavlink.stack.fence import Fence
from qrsim.links.mavlink.stack.geodesy import Geodesy
from qrsim.links.mavlink.stack.parameters import Parameters
from qrsim.links.mavlink.stack.path import STANDS, Path

# A vehicle that has risen so far from where it stood flies [m]; until then it goes straight up.
RISEN, UPRIGHT_UNTIL = 0.1, 0.5
# A set-point that asks for so much height above where a vehicle stands takes off [m]; nearer to that height than the
# second, the ground is expected at once [m].
TAKES_OFF, LOW = 0.2, 1.0
# Where the ground seems to be, a place may be so far below the floor of the area [m].
FLOOR = 0.5
# MPC_YAW_MODE, of which 0 is the place that it goes to.
TO_HOME, FROM_HOME, ALONG, TURN_FIRST = 1, 2, 3, 4
# With less of a speed [m/s] there is no way to look along; a turn is done within this angle [rad], as MIS_YAW_ERR.
SLOW, TURNED = 0.5, math.radians(12.0)
ZERO: Triple = (0.0, 0.0, 0.0)

# Takes FAILURE_UNIT, FAILURE_TYPE, instances (none: all) and the charge at which a battery is critical.
Injector = Callable[[int, int, Sequence[int], float], tuple[Result, str]]


class Craft:
    """One vehicle.

    Attributes:
        seen: what it saw last.
        home: where it returns to.
        origin: of its local frame, in the site's frame NED [m]: its position when its estimator began, as that of PX4's
            VehicleLocalPosition; or the site.
        fence: that of the plan within the area of the scenario, or that area alone.
        area: that of the scenario, where a flight ends that leaves it.
        path: the point that it follows.
        yaw: heading that it is asked for [rad].
        cruise: horizontal speed that was asked for [m/s]; None: that of the parameters.
        climb, sink: vertical speeds that were asked for [m/s]; None: those of the parameters.
        landed: what it says of itself.
        stood_z: position down where it stood last [m].
        flies: whether it has left the ground since.
        rose: whether it was half a metre above that place since.
        critical: whether a failsafe is at work.
        terminated: whether its flight was terminated, which holds until a reboot.
        injector: lets its parts fail as clients ask; None: it cannot.
    """

    def __init__(self, facts: Facts, parameters: Parameters, geodesy: Geodesy):
        self.facts, self.parameters, self.geodesy = facts, parameters, geodesy
        self.fence = self.area = Fence(facts.zones, ground=facts.ground_down)
        self._texts: list[Text] = []
        self._events: list[Event] = []
        self.injector: Injector | None = None
        self.reset()

    def reset(self) -> None:
        """Reset the vehicle's data as after a boot."""
        self.seen = Seen()
        self._idle: Order | None = None
        self._known = (ZERO, ZERO, ZERO, self.geodesy.height)
        self.home: Home | None = None
        self.origin: Triple = ZERO
        self._estimates = 0
        self.path = Path()
        self.yaw = 0.0
        self.cruise: float | None = None
        self.climb: float | None = None
        self.sink: float | None = None
        self.landed = Landed.ON_GROUND
        self.stood_z = 0.0
        self.flies = self.rose = self.critical = self.terminated = False

    # ---- what it says ----

    def say(self, severity: Severity, text: str) -> None:
        """Queue a STATUSTEXT for all clients."""
        # A text that nobody fetches is dropped, the oldest first.
        del self._texts[:-63]
        self._texts.append(Text(severity, text))

    def tell(self, kind: EventKind, number: int = 0) -> None:
        """Queue an event for clients, such as a change of mode; ``number``: see ``Event``."""
        del self._events[:-255]
        self._events.append(Event(kind, number))

    def texts(self) -> list[Text]:
        """Return the queued status texts, and empty the queue."""
        said, self._texts = self._texts, []
        return said

    def events(self) -> list[Event]:
        """Return the queued events, and empty the queue."""
        told, self._events = self._events, []
        return told

    # ---- where it is ----

    def look(self, seen: Seen) -> None:
        """Store the vehicle's state of this tick; an invalid estimate is replaced by the last valid one."""
        if seen.valid:
            self._known = (seen.position_ned, seen.velocity_ned, seen.attitude, seen.altitude)
            self._estimates += 1
            # The first estimate is older than the first readings.
            if self._estimates == 2 and self.facts.local_origin == "start":
                self.origin = seen.position_ned
        else:
            place, velocity, attitude, altitude = self._known
            seen = replace(seen, position_ned=place, velocity_ned=velocity, attitude=attitude, altitude=altitude)
        self.seen = seen
        if seen.on_ground:
            self.stood_z = seen.position_ned[2]
            self.flies = self.rose = False
        elif not self.flies and self.stood_z - seen.position_ned[2] > RISEN:
            self.flies = True
        self.rose = self.rose or self.stood_z - seen.position_ned[2] > UPRIGHT_UNTIL

    def set_home(self, home: Home) -> None:
        """Set the home position and queue an event for clients."""
        self.home = home
        self.tell("home")

    def home_here(self) -> bool:
        """Set home to the vehicle's position; return False, and change nothing, if there is no valid position."""
        seen = self.seen
        if not (seen.valid and math.isfinite(seen.latitude + seen.longitude + seen.altitude)):
            return False
        self.set_home(Home(seen.latitude, seen.longitude, seen.altitude, seen.position_ned, seen.attitude[2]))
        return True

    @property
    def home_z(self) -> float:
        """NED z coordinate [m] of home; 0 without a home."""
        return self.home.position_ned[2] if self.home else 0.0

    def z_of_altitude(self, altitude: float) -> float:
        """Convert an altitude above mean sea level [m] at the vehicle's position to an NED z coordinate [m]."""
        return self.seen.position_ned[2] - (altitude - self.seen.altitude)

    def allows(self, place: Triple, lands: bool = False) -> bool:
        """Return whether a position NED [m] is inside the fence, and between floor and ceiling of the flight area.

        On the ground heights do not count; ``lands``: the floor does not.
        """
        facts = self.facts
        high = place[2] < facts.z_min or (place[2] > facts.z_max + FLOOR and not lands)
        return self.fence.inside(*place) and (facts.mav_type == GROUND_ROVER or not high)

    # ---- where it goes ----

    def speeds(self) -> Triple:
        """Return the speed limits [m/s] of automatic flight: horizontal, upward, downward."""
        values, facts = self.parameters.values, self.facts
        cruise = values["MPC_XY_CRUISE"] if self.cruise is None else self.cruise
        up = values["MPC_Z_VEL_MAX_UP"] if self.climb is None else self.climb
        down = values["MPC_Z_VEL_MAX_DN"] if self.sink is None else self.sink
        return (
            min(cruise, values["MPC_XY_VEL_MAX"], facts.speed_limit),
            min(up, facts.climb_limit),
            min(down, facts.sink_limit),
        )

    def begin_path(self) -> None:
        """Start the vehicle's path at its present position and velocity."""
        self.path.begin(self.seen.position_ned, self.seen.velocity_ned)

    @property
    def is_low(self) -> bool:
        """Whether the vehicle is within LOW [m] of the height at which it last stood on the ground."""
        return abs(self.stood_z - self.seen.position_ned[2]) < LOW

    def is_ground(self, z: float) -> bool:
        """Return whether an NED z coordinate [m] is close to the ground on which the vehicle last stood."""
        return -TAKES_OFF <= z - self.stood_z < LOW

    def stopping_place(self) -> Triple:
        """Return the position NED [m] at which the path would end if it braked now; never below the vehicle."""
        stop = self.path.stop(self.parameters.values["MPC_ACC_HOR"])
        return stop[0], stop[1], min(stop[2], self.seen.position_ned[2])

    def go(
        self,
        goal: Triple,
        speeds: Triple | None = None,
        beyond: float = 0.0,
        along: Triple = STANDS,
        begin: Triple | None = None,
    ) -> Order:
        """Move the path by one tick to a goal NED [m], on the line from ``begin`` if given, and only up just after
        lift-off; return the order to follow the path.

        Args:
            goal: NED [m].
            speeds: largest horizontal, upward and downward one [m/s]; None: those of automatic flight.
            beyond: how far beyond the goal the way goes on [m].
            along: velocity of the goal itself [m/s].
            begin: of the straight line to the goal that it keeps to [m]; None: it need not keep to a line.
        """
        seen, path, values = self.seen, self.path, self.parameters.values
        here = seen.position_ned
        low = not self.flies or self.stood_z - here[2] < UPRIGHT_UNTIL
        if low and (goal[2] < here[2] or along[2] < 0.0):
            # Where it stands or has just left the ground, nothing may pull it sideways.
            path.position = (here[0], here[1], path.position[2])
            path.velocity, path.acceleration = (0.0, 0.0, path.velocity[2]), (0.0, 0.0, path.acceleration[2])
            goal, along, begin = (here[0], here[1], goal[2]), (0.0, 0.0, along[2]), None
        limits = (values["MPC_ACC_HOR"], values["MPC_JERK_AUTO"])
        speeds = speeds or self.speeds()
        path.move(goal, here, speeds, limits, self.facts.time_step, beyond, along, begin)
        return self.follow(path.position, path.velocity, path.acceleration)

    def follow(self, position: Triple, velocity: Triple = ZERO, acceleration: Triple = ZERO) -> Order:
        """Return the order to be at a position NED [m] with a velocity [m/s] and acceleration [m/s^2], at the commanded
        heading."""
        self._idle = None
        return Order(self.facts.name, "path", (*position, *velocity, *acceleration, self.yaw))

    def fly(self, velocity: Triple) -> Order:
        """Return the order to fly at a velocity NED [m/s], at the commanded heading."""
        self._idle = None
        return Order(self.facts.name, "velocity", (*velocity, self.yaw))

    def lean(self, roll: float, pitch: float, throttle: float) -> Order:
        """Return the order to hold a roll and pitch [rad], clipped to the tilt limit, with a throttle from 0 to 1."""
        self._idle = None
        facts = self.facts
        most = facts.tilt_max
        roll = min(max(roll / facts.roll_gain, -most), most)
        pitch = min(max(pitch / facts.pitch_gain, -most), most)
        return Order(facts.name, "attitude", (roll, pitch, self.yaw, throttle))

    @property
    def freedom(self) -> float:
        """Share of the tilt limit that is allowed: 0 on the ground, rising to 1 at UPRIGHT_UNTIL [m] above it."""
        if self.rose or not self.flies:
            return float(self.flies)
        risen = self.stood_z - self.seen.position_ned[2]
        return min(max((risen - RISEN) / (UPRIGHT_UNTIL - RISEN), 0.0), 1.0)

    def throttle_of(self, thrust: float) -> float:
        """Convert a thrust on PX4's scale, on which ``MPC_THR_HOVER`` carries the weight, to the vehicle's throttle, 0
        to 1.

        Both are 0 to 1; the scale has two straight parts, as PX4's rescaled throttle curve.
        """
        return _through(thrust, self.parameters.values["MPC_THR_HOVER"], self.facts.hover_throttle)

    def thrust_of(self, throttle: float) -> float:
        """Convert a throttle, 0 to 1, to a thrust on PX4's scale: the inverse of ``throttle_of``."""
        return _through(throttle, self.facts.hover_throttle, self.parameters.values["MPC_THR_HOVER"])

    def idle(self) -> Order | None:
        """Return the order to stop the motors; None if they were already ordered to stop."""
        if self._idle is not None:
            return None
        order = self.lean(0.0, 0.0, 0.0)
        self._idle = order
        return order

    def turn_to(self, yaw: float) -> None:
        """Set the commanded heading [rad]."""
        self.yaw = math.remainder(yaw, 2.0 * math.pi)

    def look_to(self, north: float, east: float, farther: float = 1.0) -> None:
        """Point the commanded heading at a position (north, east) [m], unless it is nearer than ``farther`` [m]."""
        here = self.seen.position_ned
        dx, dy = north - here[0], east - here[1]
        if dx * dx + dy * dy > farther * farther:
            self.yaw = math.atan2(dy, dx)

    def head_to(self, north: float, east: float, farther: float = 1.0) -> bool:
        """Set the heading for flight to (north, east) [m], as ``MPC_YAW_MODE`` asks; return whether to turn before
        moving."""
        mode, home = int(self.parameters.values["MPC_YAW_MODE"]), self.home
        if mode in (TO_HOME, FROM_HOME) and home is not None:
            self.look_to(home.position_ned[0], home.position_ned[1], farther)
            here = self.seen.position_ned
            if mode == FROM_HOME and math.dist(here[:2], home.position_ned[:2]) > farther:
                self.turn_to(self.yaw + math.pi)
            return False
        vn, ve, _ = self.path.velocity
        if mode == ALONG:
            if math.hypot(vn, ve) > SLOW:
                self.yaw = math.atan2(ve, vn)
            return False
        self.look_to(north, east, farther)
        off = math.remainder(self.yaw - self.seen.attitude[2], 2.0 * math.pi)
        return mode == TURN_FIRST and abs(off) > TURNED and math.hypot(vn, ve) < SLOW


def _through(value: float, middle: float, image: float) -> float:
    """Map a number 0 to 1 by two straight lines through (0, 0), (``middle``, ``image``) and (1, 1)."""
    if value <= middle or middle >= 1.0:
        return image * value / middle
    return image + (1.0 - image) * (value - middle) / (1.0 - middle)
