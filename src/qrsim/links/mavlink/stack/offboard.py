"""Set-points from outside: what of them can be flown, and the orders that they become."""

from __future__ import annotations

import math

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.codes import Severity
from qrsim.links.mavlink.stack.contracts import NAN, AttitudeTarget, GlobalTarget, LocalTarget, Target, Triple
from qrsim.links.mavlink.stack.craft import TAKES_OFF, Craft
from qrsim.links.mavlink.stack.fence import AMSL, GLOBAL, RELATIVE
from qrsim.links.mavlink.stack.landing import IDLE_AFTER, LANDED_AFTER, Descent
from qrsim.links.mavlink.stack.lifting import Lift

# MAV_FRAME: local, from here along north and east, and twice from here along the heading.
LOCAL_NED, LOCAL_OFFSET, BODY_NED, BODY_OFFSET, BODY_FRD = 1, 7, 8, 9, 12
# POSITION_TARGET_TYPEMASK: three bits each, then whether the acceleration is a force, and yaw and its rate.
FORCE, NO_YAW, NO_YAW_RATE = 0x200, 0x400, 0x800
# ATTITUDE_TARGET_TYPEMASK.
NO_RATES, NO_THRUST, NO_ATTITUDE = 0x7, 0x40, 0x80
# GUID_OPTIONS of ArduPilot: the thrust of an attitude is one, and not a climb.
THRUST_AS_THRUST = 8
# Larger numbers than this are no places, velocities or angles.
LARGEST = 1e6
# A set-point that asks for such a climb takes off [m/s].
CLIMBS = 0.1


class Offboard:
    """The set-point of one vehicle.

    Attributes:
        heard: when the last one came [s]; None before the first.
        lands: whether the set-point asks it to come down.
        keeps_places: a place alone is said once, and holds without another set-point, as in ArduPilot's GUIDED.
        climbs: thrust asks for a climb: 0.5 holds the height, as in ArduPilot's GUIDED.
    """

    def __init__(self) -> None:
        self.keeps_places = self.climbs = False
        self.heard: float | None = None
        self.lands = False
        self._kind = "none"
        self._position: Triple = (NAN, NAN, NAN)
        self._velocity: Triple = (NAN, NAN, NAN)
        self._acceleration: Triple = (NAN, NAN, NAN)
        self._yaw, self._yaw_rate = NAN, NAN
        self._tilt: tuple[float, float] | None = None
        self._rates: Triple = (0.0, 0.0, 0.0)
        self._thrust = 0.0
        self._z, self._went = 0.0, False
        self._descent, self._lift = Descent(), Lift()
        self._descends = False
        self._complained = -math.inf

    # ---- what comes in ----

    def take(self, target: Target, craft: Craft) -> bool:
        """Store a client's set-point; return whether it is accepted, and warn clients if not."""
        if isinstance(target, AttitudeTarget):
            why = self._take_attitude(target, craft)
        elif isinstance(target, LocalTarget):
            why = self._take_local(target, craft)
        else:
            why = self._take_global(target, craft)
        if why:
            return self.refuse(craft, why)
        self.heard = craft.seen.time
        return True

    def refuse(self, craft: Craft, why: str) -> bool:
        """Warn clients, at most every 5 s, why a set-point is refused; always return False."""
        if craft.seen.time - self._complained >= 5.0 or craft.seen.time < self._complained:
            self._complained = craft.seen.time
            craft.say(Severity.WARNING, f"Set-point refused: {why}")
        return False

    def _take_local(self, target: LocalTarget, craft: Craft) -> str:
        """Store a set-point in a local frame; return "", or why it is refused."""
        frame = target.frame
        if frame not in (LOCAL_NED, LOCAL_OFFSET, BODY_NED, BODY_OFFSET, BODY_FRD):
            return f"frame {frame} is not supported"
        position, velocity, acceleration = _unmasked(target)
        if frame not in (LOCAL_NED, LOCAL_OFFSET):
            yaw = craft.seen.attitude[2]
            position, velocity, acceleration = (_turned(part, yaw) for part in (position, velocity, acceleration))
        begin = craft.origin if frame == LOCAL_NED else craft.seen.position_ned
        position = (begin[0] + position[0], begin[1] + position[1], begin[2] + position[2])
        return self._take_motion(target, position, velocity, acceleration)

    def _take_global(self, target: GlobalTarget, craft: Craft) -> str:
        """Store a set-point in latitude and longitude; return "", or why it is refused."""
        if target.frame not in GLOBAL:
            return f"frame {target.frame} is not supported"
        ignored, velocity, acceleration = _unmasked(target)
        position: Triple = (NAN, NAN, NAN)
        if not math.isnan(ignored[0] + ignored[1] + ignored[2]):
            latitude, longitude, altitude = target.lat_int * 1e-7, target.lon_int * 1e-7, target.alt
            if abs(latitude) > 90.0 or abs(longitude) > 180.0 or math.isinf(altitude):
                return "no such place"
            if target.frame in RELATIVE:
                altitude += craft.home.altitude if craft.home else craft.geodesy.height
            elif target.frame not in AMSL:
                altitude += craft.geodesy.height
            position = craft.geodesy.to_ned(latitude, longitude, altitude)
        return self._take_motion(target, position, velocity, acceleration)

    def _take_motion(
        self, target: LocalTarget | GlobalTarget, position: Triple, velocity: Triple, acceleration: Triple
    ) -> str:
        """Store a set-point of position, velocity and acceleration, NED, NaN where unset; return "", or why it is
        refused."""
        numbers = (*position, *velocity, *acceleration)
        yaw = NAN if target.mask & NO_YAW else target.yaw
        rate = NAN if target.mask & NO_YAW_RATE else target.yaw_rate
        if any(abs(number) > LARGEST for number in (*numbers, yaw, rate)):
            return "numbers too large"
        # Where accelerations are left out, what they are counts for nothing: many a client's mask has all bits.
        if target.mask & FORCE and any(map(math.isfinite, acceleration)):
            return "forces are not supported"
        for axis, name in enumerate("xyz"):
            if all(math.isnan(part[axis]) for part in (position, velocity, acceleration)):
                return f"{name} has no number"
        # Height alone, or the like, is held by what is given for each axis.
        self._kind = "motion"
        self._position, self._velocity, self._acceleration = position, velocity, acceleration
        self._yaw, self._yaw_rate = yaw, rate
        return ""

    def _take_attitude(self, target: AttitudeTarget, craft: Craft) -> str:
        """Store a set-point of attitude or body rates, and thrust; return "", or why it is refused."""
        if target.mask & NO_THRUST or not 0.0 <= target.thrust <= 1.0:
            return f"thrust {target.thrust:g}, 0 to 1 needed" if not target.mask & NO_THRUST else "no thrust"
        tilt, yaw = None, NAN
        if not target.mask & NO_ATTITUDE:
            size = math.sqrt(sum(part * part for part in target.q))
            if not 0.5 < size < 2.0:
                return "quaternion is none"
            roll, pitch, yaw = _euler(*(part / size for part in target.q))
            tilt = (roll, pitch)
        elif target.mask & NO_RATES == NO_RATES:
            return "neither attitude nor rates"
        rates = tuple(0.0 if target.mask & (1 << axis) else target.rates[axis] for axis in range(3))
        if not all(map(math.isfinite, rates)):
            return "rates are not finite"
        self._kind, self._thrust, self._yaw = "attitude", target.thrust, yaw
        self._tilt, self._rates = tilt, (rates[0], rates[1], rates[2])
        self.climbs = self.keeps_places and not int(craft.parameters["GUID_OPTIONS"]) & THRUST_AS_THRUST
        return ""

    # ---- what goes out ----

    def fresh(self, craft: Craft, limit: float) -> bool:
        """Return whether the last set-point is at most ``limit`` [s] old, or is a position, which does not expire."""
        if self.keeps_places and self._is_place:
            return True
        # A small part of a tick is left for the rounding of times.
        return self.heard is not None and craft.seen.time - self.heard < limit + 0.01 * craft.facts.time_step

    @property
    def _is_place(self) -> bool:
        """Return whether the set-point is a position without a velocity."""
        return (
            self._kind == "motion" and all(map(math.isfinite, self._position)) and all(map(math.isnan, self._velocity))
        )

    def begin(self, craft: Craft) -> None:
        """Reset flight by set-points to the vehicle's present position and heading, when the mode begins."""
        self._descent.begin()
        self._descends = False
        self._lift.begin(craft)
        craft.begin_path()
        self._went = False
        self._leaning = craft.seen.attitude[:2]
        craft.yaw = craft.seen.attitude[2]

    def fly(self, craft: Craft) -> tuple[Order | None, bool]:
        """Follow the stored set-point for one tick; return the order, and whether the vehicle has landed."""
        dt, here = craft.facts.time_step, craft.seen.position_ned
        if self._kind == "attitude":
            return self._fly_attitude(craft, dt)
        if math.isfinite(self._yaw):
            craft.turn_to(self._yaw)
        elif math.isfinite(self._yaw_rate):
            craft.turn_to(craft.yaw + self._yaw_rate * dt)
        self.lands = not self._rises(craft)
        if not craft.flies and self.lands:
            return craft.idle(), self._descent.touchdown.seconds(craft, here[2]) >= LANDED_AFTER
        if not self.lands:
            self._descent.begin()
            self._descends = False
            self._z = here[2]
            return self._motion(craft, dt), False
        lands_here = all(map(math.isfinite, self._position)) and craft.is_ground(self._position[2]) and craft.is_low
        if lands_here:
            if not self._descends:
                craft.begin_path()
            self._descends = True
            return self._descent.fly(craft, self._position)
        self._descends = False
        # A place is as low as it is; a velocity leads down for as long as it is asked for.
        deep = self._position[2] if math.isfinite(self._position[2]) else max(self._z, here[2]) + self._sinks() * dt
        self._z = deep
        on = self._descent.touchdown.seconds(craft, self._z)
        if on >= IDLE_AFTER:
            return craft.idle(), on >= LANDED_AFTER
        return self._motion(craft, dt), False

    def _sinks(self) -> float:
        """Return the descent speed [m/s] near the ground: that of the set-point, else 0.5."""
        return self._velocity[2] if self._velocity[2] > 0.0 else 0.5

    def _rises(self, craft: Craft) -> bool:
        """Return whether the set-point asks for take-off, or for flight if the vehicle is in the air."""
        here = craft.seen.position_ned[2]
        if math.isfinite(self._position[2]):
            # In flight, a place no higher than the estimate may drift above where it stood is a landing: nobody hovers
            # there, and a vehicle that tries to drags its feet over the ground.
            return self._position[2] < (craft.stood_z if craft.flies else here) - TAKES_OFF
        down = self._velocity[2]
        if math.isfinite(down):
            return down < (CLIMBS if craft.flies else -CLIMBS)
        return self._acceleration[2] < (0.5 if craft.flies else -0.5)

    def _motion(self, craft: Craft, dt: float) -> Order:
        """Return the order for a set-point of position, velocity or acceleration, within the speed limits; ``dt``: tick
        [s]."""
        position, velocity, acceleration = self._position, self._velocity, self._acceleration
        values, facts, seen = craft.parameters.values, craft.facts, craft.seen
        level = min(values["MPC_XY_VEL_MAX"], facts.speed_limit)
        up, down = min(values["MPC_Z_VEL_MAX_UP"], facts.climb_limit), min(values["MPC_Z_VEL_MAX_DN"], facts.sink_limit)
        moves = [math.isfinite(part) for part in velocity]
        if all(map(math.isfinite, position)) and not any(moves):
            if not self._went:
                craft.begin_path()
                self._went = True
            if self.keeps_places and craft.cruise is not None:
                # In ArduPilot's GUIDED the speed of DO_CHANGE_SPEED counts for places.
                level = min(level, craft.cruise)
            return craft.go(position, (level, up, down))
        self._went = False
        if all(moves) and not any(map(math.isfinite, (*position, *acceleration))):
            return craft.fly(_limited(velocity, level, up, down))
        place, along, push = [], [], []
        for axis in range(3):
            wanted, speed, extra = position[axis], velocity[axis], acceleration[axis]
            free = math.isnan(wanted)
            place.append(seen.position_ned[axis] if free else wanted)
            if math.isnan(speed):
                # A free axis that is pushed goes on as it does.
                speed = seen.velocity_ned[axis] if free else 0.0
            along.append(speed)
            push.append(0.0 if math.isnan(extra) else extra)
        motion = _limited((along[0], along[1], along[2]), level, up, down)
        return craft.follow((place[0], place[1], place[2]), motion, (push[0], push[1], push[2]))

    def level(self, craft: Craft) -> None:
        """Set a level attitude as the set-point, at the present heading and height, as ArduPilot's GUIDED_NOGPS
        does."""
        self._kind, self.climbs, self._thrust = "attitude", True, 0.5
        self._tilt, self._rates, self._yaw = (0.0, 0.0), (0.0, 0.0, 0.0), craft.yaw
        self.heard = None

    def _fly_attitude(self, craft: Craft, dt: float) -> tuple[Order | None, bool]:
        """Return the order for a set-point of attitude or rates, and whether the vehicle has landed; ``dt``: tick
        [s]."""
        roll, pitch = self._lean(craft, dt)
        if not self.climbs:
            landed = craft.seen.on_ground and self._thrust < 0.1
            return craft.lean(roll, pitch, craft.throttle_of(self._thrust)), landed
        share, values, facts = 2.0 * self._thrust - 1.0, craft.parameters.values, craft.facts
        up, down = min(values["MPC_Z_VEL_MAX_UP"], facts.climb_limit), min(values["MPC_Z_VEL_MAX_DN"], facts.sink_limit)
        self.lands = craft.flies and share < 0.0
        stands = self._lift.stands(craft, share > 0.0, self.lands)
        if stands is not None:
            return stands
        sinks = -share * (up if share > 0.0 else down)
        return craft.lean(roll, pitch, self._lift.throttle(craft, sinks, (facts.speed_limit, up, down))), False

    def _lean(self, craft: Craft, dt: float) -> tuple[float, float]:
        """Return the roll and pitch [rad] of the set-point, integrating its rates over ``dt`` [s], and set the
        heading."""
        rates, freedom = self._rates, craft.freedom
        if not freedom:
            # What stands and leans tips over.
            craft.yaw = craft.seen.attitude[2]
            self._leaning = roll, pitch = 0.0, 0.0
        elif self._tilt is not None:
            roll, pitch = self._tilt
            craft.yaw = self._yaw
        else:
            # Tilt and throttle are what the platform takes: rates are added up.
            most = craft.facts.tilt_max
            roll = min(max(self._leaning[0] + rates[0] * dt, -most), most)
            pitch = min(max(self._leaning[1] + rates[1] * dt, -most), most)
            craft.turn_to(craft.yaw + rates[2] * dt)
        self._leaning = (roll, pitch)
        return freedom * roll, freedom * pitch


def _unmasked(target: LocalTarget | GlobalTarget) -> tuple[Triple, Triple, Triple]:
    """Return position, velocity and acceleration of a client's set-point, NaN where its type mask ignores them."""
    position = target.position if isinstance(target, LocalTarget) else (0.0, 0.0, target.alt)
    parts = []
    for shift, part in ((0, position), (3, target.velocity), (6, target.acceleration)):
        bits = target.mask >> shift
        parts.append((NAN if bits & 1 else part[0], NAN if bits & 2 else part[1], NAN if bits & 4 else part[2]))
    return parts[0], parts[1], parts[2]


def _turned(vector: Triple, yaw: float) -> Triple:
    """Rotate a vector from heading axes to NED by a yaw [rad]; NaN on one horizontal axis gives NaN on both."""
    sine, cosine = math.sin(yaw), math.cos(yaw)
    return cosine * vector[0] - sine * vector[1], sine * vector[0] + cosine * vector[1], vector[2]


def _limited(velocity: Triple, level: float, up: float, down: float) -> Triple:
    """Clip a velocity NED [m/s] to a horizontal (``level``), an upward and a downward speed [m/s]."""
    size = math.hypot(velocity[0], velocity[1])
    ratio = min(1.0, level / size) if size > 0.0 else 1.0
    return velocity[0] * ratio, velocity[1] * ratio, min(max(velocity[2], -up), down)


def _euler(w: float, x: float, y: float, z: float) -> Triple:
    """Convert a unit quaternion, body to NED, to roll, pitch and yaw [rad]."""
    pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return roll, pitch, math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
