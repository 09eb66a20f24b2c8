"""The flight stack of a fixed wing: in the air from the start, it flies missions, circles, and home; it never lands."""

from __future__ import annotations

import math
from dataclasses import replace

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack import orbits
from qrsim.links.mavlink.stack.codes import Landed, Result, Severity
from qrsim.links.mavlink.stack.commands import place_in
from qrsim.links.mavlink.stack.contracts import Ack, Command, Home, Item, Seen, Target, Triple
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.stack.modes import WING_FLAVOURS, Mode
from qrsim.links.mavlink.stack.plan import place_of
from qrsim.links.mavlink.stack.tour import NO_RUNWAY, REACH, Tour, why_no_airspeed, why_no_speed

LAND, TAKE_OFF, ORBIT, TURN, CHANGE_SPEED, REPOSITION = 21, 22, 34, 115, 178, 192
# A set-point that is refused is said once in so long [s].
SAID_EVERY_S = 5.0


class WingStack(FlightStack):
    """See ``contracts.Stack``; the arguments are those of ``FlightStack``.

    It goes by its scenario's guidance, in hold, until a client asks for something else.
    """

    takes_setpoints = False
    plan: Tour
    _flavours = WING_FLAVOURS
    _plan = Tour

    def reset(self) -> None:
        """Restart as after a boot; a fixed wing starts in the air."""
        super().reset()
        self.armed, self.craft.landed = True, Landed.IN_AIR
        self._own, self._radius = True, math.nan
        self._glides, self._said_at = False, -SAID_EVERY_S

    # ---- ticks ----

    def tick(self, seen: Seen) -> Order | None:
        """Advance by one tick with the vehicle's present state; return its new order, or None to keep the last one."""
        craft = self.craft
        craft.look(seen)
        craft.flies = True
        self.checks.look(craft)
        if craft.home is None and seen.valid and seen.fix_type >= 3:
            self._home_below()
        if seen.stopped:
            self._end(seen.stopped)
            return None
        if self.armed:
            asked = self.failsafes.look(craft, self.mode, self.offboard, self.factor)
            if asked:
                self._fail_over(asked)
        if not self.armed:
            # With the motor off, level wings.
            glides, self._glides = self._glides, True
            return None if glides else Order(self.facts.name, "control", (0.0, 0.0, 0.0))
        self._glides = False
        return self._fly()[0] if seen.valid else None

    def _end(self, why: str) -> None:
        """End the vehicle's run after a crash or touch-down: disarm, and send clients the reason ``why`` once."""
        craft = self.craft
        if craft.landed is Landed.ON_GROUND:
            return
        craft.say(Severity.EMERGENCY, f"Run has ended: {why}")
        self.disarm("")
        craft.landed = Landed.ON_GROUND
        craft.tell("landed")

    def _fly(self) -> tuple[Order | None, bool]:
        """Return the order of the present mode, or None to leave it to the scenario's guidance, and False (never
        landed)."""
        craft = self.craft
        if self.mode is Mode.MISSION:
            order, over = self.plan.fly(craft)
            if over and self.plan.returns:
                self.switch(Mode.RTL)
            elif over:
                craft.say(Severity.INFO, "Mission finished, loitering")
                end, radius = self.plan.end, orbits.usual_radius(craft)
                self.switch(Mode.HOLD, goal=end and orbits.fitted(craft, end, radius))
            return order, False
        if self._own:
            return None, False
        if self._goal is None:
            self._goal, self._radius = orbits.here(craft)
        radius = self._radius if math.isfinite(self._radius) else orbits.usual_radius(craft)
        order = orbits.circle(craft, self._goal, radius)
        if self.mode is Mode.RTL:
            self._come_down(order)
        return order, False

    def _come_down(self, order: Order) -> None:
        """Lower the loiter circle to the height of a return, once the vehicle has reached it; ``order``: the one that
        flies it."""
        craft, goal = self.craft, self._goal
        assert goal is not None
        here = craft.seen.position_ned
        if math.hypot(here[0] - goal[0], here[1] - goal[1]) < abs(order.numbers[6]) + REACH:
            self._goal = (goal[0], goal[1], max(self._return_z(), craft.facts.z_min + orbits.BELOW))

    def _return_z(self) -> float:
        """Return the NED z coordinate [m] of the circle of a return to home."""
        return self.craft.home_z - self.parameters["RTL_RETURN_ALT"]

    def _home_below(self) -> None:
        """Set home to the point at z = 0 below the vehicle."""
        craft = self.craft
        north, east, _ = craft.seen.position_ned
        ground = (north, east, 0.0)
        craft.set_home(Home(*craft.geodesy.to_geodetic(ground), ground, craft.seen.attitude[2]))

    # ---- arming ----

    def arm(self, force: bool = False) -> Result:
        """Arm the fixed wing, or send clients the reasons against it and return the refusal; ``force`` skips the
        checks."""
        home, armed = self.craft.home, self.armed
        result = super().arm(force)
        if self.armed and not armed:
            self.craft.landed = Landed.IN_AIR
            if home is not None:
                self.craft.set_home(home)
        return result

    def disarm(self, why: str) -> None:
        """Stop the motor and glide; ``why`` is a text for clients."""
        super().disarm(why)
        self.craft.landed = Landed.IN_AIR

    # ---- modes and commands ----

    def request(self, mode: Mode) -> Result:
        """Change to a flight mode for a client, or send clients the reason against it and return the refusal."""
        if mode in self.flavour.modes or mode is Mode.GUIDED:
            if mode is Mode.HOLD and self._own:
                self.switch(Mode.HOLD)
            return super().request(mode)
        self._refuse("Mode", f"a fixed wing has no {mode.value}")
        return Result.DENIED

    def switch(self, mode: Mode, goal: Triple | None = None) -> None:
        """Change the flight mode without checks; LAND becomes an endless return, and a mode that a wing lacks becomes
        HOLD."""
        if mode is Mode.LAND:
            mode = Mode.RTL
        if mode not in self.flavour.modes:
            mode = Mode.HOLD
        self._own, self._radius = False, math.nan
        super().switch(mode, self._way_home() if mode is Mode.RTL else goal)

    def _way_home(self) -> Triple | None:
        """Return the centre NED [m] of the circle of a return: at the nearest of home and rally points, not below the
        vehicle."""
        craft = self.craft
        here = craft.seen.position_ned
        places = [craft.home.position_ned] if craft.home else [here]
        places += [place_of(item, craft, here) for item in self.rally]
        place = min(places, key=lambda place: math.hypot(place[0] - here[0], place[1] - here[1]))
        high = (place[0], place[1], min(here[2], self._return_z()))
        return orbits.fitted(craft, high, orbits.usual_radius(craft))

    def command(self, command: Command) -> Ack:
        """Execute or refuse a command; DO_ORBIT is treated as a DO_REPOSITION with a radius, as PX4's navigator
        does."""
        if command.id == ORBIT and self.flavour.name == "px4":
            radius = command.params[0]
            turns = (abs(radius), 1.0 if radius < 0.0 else 0.0)
            command = replace(command, id=REPOSITION, frame=0, params=(math.nan, 1.0, *turns, *command.params[4:]))
        why = self._why_not(command)
        if why:
            self._refuse(f"Command {command.id}", why)
            return Ack(Result.DENIED)
        ack = super().command(command)
        if command.id == REPOSITION and ack.result is Result.ACCEPTED:
            self._radius = _signed_radius(command)
        return ack

    def _why_not(self, command: Command) -> str:
        """Return why a fixed wing cannot obey a command; "" if it can, or if a later check decides."""
        params = command.params
        if any(map(math.isinf, params)):
            return ""
        if command.id in (LAND, TAKE_OFF):
            return NO_RUNWAY
        if command.id == TURN:
            return "a fixed wing does not turn on the spot"
        if command.id == CHANGE_SPEED:
            return why_no_speed(0.0 if math.isnan(params[0]) else params[0], params[1], self.craft)
        if command.id == REPOSITION:
            return self._why_not_there(command)
        return ""

    def _why_not_there(self, command: Command) -> str:
        """Return why the vehicle cannot circle at the position of a DO_REPOSITION; "" if it can."""
        craft, speed, radius = self.craft, command.params[0], _signed_radius(command)
        if speed > 0.0 and why_no_airspeed(speed, craft):
            return why_no_airspeed(speed, craft)
        fast = speed if speed > 0.0 else orbits.airspeed(craft)
        least, why = orbits.tightest(fast), orbits.why_no_radius(radius, fast)
        if why:
            return why
        place = place_in(self, command) if craft.home else None
        radius = radius if math.isfinite(radius) else orbits.usual_radius(craft)
        if place is not None and not orbits.fits(craft.fence, place, max(abs(radius), least)):
            return f"a circle of {max(abs(radius), least):.0f} m there leaves the fence"
        return ""

    def change_altitude(self, item: Item) -> None:
        """Circle at the altitude of a guided item, as ArduPilot's Plane does; refused unless the mode is HOLD."""
        craft = self.craft
        place = place_in(self, Command.of_int(REPOSITION, item.frame, (math.nan,) * 4, 0, 0, item.z))
        if self.mode is not Mode.HOLD or place is None or not craft.allows(place):
            why = "no height of the area" if self.mode is Mode.HOLD else "it is not in hold"
            self._refuse("Change of altitude", why)
            return
        if self._own or self._goal is None:
            self._goal, self._radius = orbits.here(craft)
            self._own = False
        self._goal = (self._goal[0], self._goal[1], max(place[2], craft.facts.z_min + orbits.BELOW))

    def setpoint(self, target: Target) -> bool:
        """Refuse any set-point, since a fixed wing has no OFFBOARD mode here; return False."""
        now = self.craft.seen.time
        if now - self._said_at >= SAID_EVERY_S:
            self._said_at = now
            self._refuse("Set-point", "a fixed wing flies missions and circles")
        return False


def _signed_radius(command: Command) -> float:
    """Return the radius [m] of a DO_REPOSITION, negative for counterclockwise (``param4`` = 1); NaN if it has none."""
    radius, turns_left = command.params[2], command.params[3] == 1.0
    return math.copysign(radius, -1.0 if turns_left else 1.0) if radius > 0.0 else math.nan
