"""The flight of one vehicle: its modes, and what leads from one to another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from qrsim.control.failsafes import DISARM, HOLD, NOTHING, TERMINATE
from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack import failsafes as grave
from qrsim.links.mavlink.stack.arming import ArmingChecks
from qrsim.links.mavlink.stack.circling import Orbit
from qrsim.links.mavlink.stack.codes import Landed, MissionState, Result, Severity
from qrsim.links.mavlink.stack.contracts import Facts, FlavourName, Item, Seen, Triple
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.failsafes import Failsafes
from qrsim.links.mavlink.stack.following import Follow
from qrsim.links.mavlink.stack.geodesy import Geodesy
from qrsim.links.mavlink.stack.landing import LANDED_AFTER, Descent
from qrsim.links.mavlink.stack.mission import Mission
from qrsim.links.mavlink.stack.modes import BY_SETPOINTS, BY_STICKS, FLAVOURS, FLIES_AGAIN, Flavour, Mode
from qrsim.links.mavlink.stack.offboard import Offboard
from qrsim.links.mavlink.stack.parameters import TABLE, Parameters
from qrsim.links.mavlink.stack.returning import Return
from qrsim.links.mavlink.stack.sim_parameters import SIM_TABLE
from qrsim.links.mavlink.stack.sticks import Sticks
from qrsim.models.site import Site

TAKEN_OFF = 0.3  # distance from its height at which a take-off is done [m]
RC_OVERRIDE_TIME = 3.0  # age at which stick messages expire in ArduPilot's flavour [s]
GUIDED_TIMEOUT = 3.0  # age of velocities at which GUIDED holds [s]: GUID_TIMEOUT (ArduCopter/Parameters.cpp)


class Flight:
    """Modes, arming and failsafes; ``FlightStack`` has what clients ask on top.

    Args:
        facts: of the vehicle.
        site: origin of its NED frame.
        parameters: its table; None: the defaults.
        flavour: whose mode numbers it speaks.
        factor: simulated seconds per second of wall time.

    Attributes:
        mode, armed: the flight mode, and whether the motors may turn.
        guided: whether HOLD is ArduPilot's GUIDED.
        craft, plan, offboard, orbit, follow, by_sticks, failsafes, checks: its parts.
        rally: points of the rally plan.
    """

    _flavours: ClassVar[Mapping[str, Flavour]] = FLAVOURS
    _plan: ClassVar[type[Mission]] = Mission

    def __init__(
        self,
        facts: Facts,
        site: Site,
        parameters: Parameters | None = None,
        flavour: FlavourName = "px4",
        factor: float = 1.0,
    ):
        self.facts, self.factor = facts, factor
        if parameters is None:
            start: dict[str, float] = {"MAV_SYS_ID": facts.system}
            if flavour == "ardupilot":
                start["COM_OF_LOSS_T"] = GUIDED_TIMEOUT
            if facts.loiter_radius:
                start["NAV_LOITER_RAD"] = facts.loiter_radius
            parameters = Parameters(start, TABLE + SIM_TABLE * (flavour == "ardupilot"))
        self.parameters, self.flavour = parameters, self._flavours[flavour]
        self.craft = Craft(facts, self.parameters, Geodesy(site, facts.datum))
        self.plan: Mission = self._plan(flavour)
        self.rally: tuple[Item, ...] = ()
        self.reset()

    def reset(self) -> None:
        """Restart as after a boot: disarmed, time at zero; parameters and plans stay."""
        self.craft.reset()
        self.mode, self.armed, self.guided = Mode.HOLD, False, False
        # Mode that was asked for, and whether its HOLD is GUIDED.
        self._meant = (Mode.HOLD, False)
        self.offboard, self.failsafes, self.checks = Offboard(), Failsafes(), ArmingChecks()
        self.orbit, self.follow, self.by_sticks, self._loiters = Orbit(), Follow(), Sticks(), False
        self.offboard.keeps_places = self.flavour.name == "ardupilot"
        self._return, self._descent = Return(), Descent()
        self._goal: Triple | None = None
        self._armed_at, self._took_off = 0.0, False
        self._landed_at: float | None = None
        if self.plan.state is not MissionState.NO_MISSION:
            self.plan.restart(self.craft)

    # ---- ticks ----

    def tick(self, seen: Seen) -> Order | None:
        """Advance by one tick with the vehicle's present state; return its new order, or None to keep the last one."""
        craft = self.craft
        craft.look(seen)
        self.checks.look(craft)
        if craft.home is None and seen.valid and seen.fix_type >= 3:
            craft.home_here()
        if self.armed and seen.stopped:
            craft.say(Severity.EMERGENCY, f"Flight has ended: {seen.stopped}")
            self.disarm("")
        if not self.armed:
            return craft.idle()
        asked = self.failsafes.look(craft, self.mode, self.offboard, self.factor)
        if self.mode in BY_STICKS:
            asked = max(asked, self.failsafes.look_at_sticks(craft, self._has_sticks))
        if asked:
            self._fail_over(asked)
        order, landed = self._fly() if self.armed else (craft.idle(), False)
        self._look_at_ground(landed)
        return order if self.armed else craft.idle() or order

    def _fly(self) -> tuple[Order | None, bool]:
        """Fly the present mode for one tick; return the order (None: keep the last one), and whether it has landed."""
        craft, mode = self.craft, self.mode
        if not craft.seen.valid and mode is not Mode.OFFBOARD:
            # Blind: level, and a little less than the weight.
            return craft.lean(0.0, 0.0, 0.95 * self.facts.hover_throttle if craft.flies else 0.0), False
        if mode in BY_STICKS or self._loiters_by_sticks():
            return self.by_sticks.fly(craft, mode if mode in BY_STICKS else Mode.POSITION)
        if mode is Mode.HOLD:
            return self._hold()
        if mode is Mode.TAKEOFF:
            return self._take_off(), False
        if mode is Mode.MISSION:
            return self._fly_mission()
        if mode is Mode.ORBIT:
            return self.orbit.fly(craft), False
        if mode is Mode.FOLLOW:
            return self.follow.fly(craft, max(1.0, self.factor)), False
        if mode is Mode.RTL:
            return self._return.fly(craft)
        if mode is Mode.LAND:
            if not self._took_off:
                return craft.idle(), True
            return self._descent.fly(craft, self._goal or craft.seen.position_ned)
        if mode is Mode.NOGPS and not self.fresh():
            self.offboard.level(craft)
        return self.offboard.fly(craft)

    def _hold(self) -> tuple[Order | None, bool]:
        """Return the order of the mode HOLD (stay, or land if held at the ground), and whether it has landed."""
        craft = self.craft
        if not craft.flies and craft.seen.on_ground:
            rests = self._descent.touchdown.seconds(craft, craft.seen.position_ned[2])
            return craft.idle(), self._took_off and rests >= LANDED_AFTER
        self._goal = self._goal or craft.stopping_place()
        if craft.flies and craft.is_ground(self._goal[2]) and craft.is_low:
            return self._descent.fly(craft, self._goal)
        return craft.go(self._goal), False

    @property
    def _has_sticks(self) -> bool:
        """Whether stick positions are recent; ArduPilot's expire after RC_OVERRIDE_TIME [s]."""
        limit = RC_OVERRIDE_TIME if self.flavour.name == "ardupilot" else self.parameters["COM_RC_LOSS_T"]
        return self.by_sticks.fresh(self.craft, limit * max(1.0, self.factor))

    def _loiters_by_sticks(self) -> bool:
        """Return whether sticks fly the vehicle in ArduPilot's LOITER mode now; handle the begin and end of that."""
        before = self._loiters
        mine = self.mode is Mode.HOLD and not self.guided and self.flavour.name == "ardupilot"
        self._loiters = mine and self._has_sticks
        if self._loiters and not before:
            self.by_sticks.begin(self.craft)
        elif before and not self._loiters:
            self._goal = None
        return self._loiters

    def _take_off(self) -> Order | None:
        """Return the order to climb to the take-off altitude; at that altitude, change to the mode HOLD."""
        craft, here = self.craft, self.craft.seen.position_ned
        if self._goal is None:
            self._goal = (here[0], here[1], craft.home_z - self.parameters["MIS_TAKEOFF_ALT"])
        if abs(self._goal[2] - here[2]) < TAKEN_OFF and craft.flies:
            self.switch(Mode.HOLD, goal=self._goal)
        level, up, down = craft.speeds()
        return craft.go(self._goal or here, (level, min(up, self.parameters["MPC_TKO_SPEED"]), down))

    def _fly_mission(self) -> tuple[Order | None, bool]:
        """Fly the mission for one tick, and change the mode at its end; return the order, and whether it has landed."""
        craft, mission = self.craft, self.plan
        order, over = mission.fly(craft)
        if not over:
            return order, False
        if mission.returns:
            self.switch(Mode.RTL)
            return order, False
        if mission.landed:
            self.mode, self._goal = Mode.LAND, craft.seen.position_ned
            self._descent.touchdown.since = mission.descent.touchdown.since
            craft.tell("mode")
            return order, True
        craft.say(Severity.INFO, "Mission finished, loitering")
        self.switch(Mode.HOLD)
        return order, False

    # ---- landing ----

    def _look_at_ground(self, landed: bool) -> None:
        """Update the landed state, and disarm a vehicle that has landed or has never taken off."""
        craft, now = self.craft, self.craft.seen.time
        self._took_off |= craft.flies
        if not self.armed:
            return
        if landed and self._took_off and self._landed_at is None:
            self._landed_at = now
            craft.say(Severity.INFO, "Landing detected")
        elif not landed and craft.flies:
            self._landed_at = None
        state = Landed.IN_AIR
        if self._landed_at is not None or not self._took_off:
            state = Landed.ON_GROUND
        elif self.mode is Mode.TAKEOFF or (self.mode is Mode.MISSION and self.plan.rises):
            state = Landed.TAKEOFF
        elif self.lands:
            state = Landed.LANDING
        if state is not craft.landed:
            craft.landed = state
            craft.tell("landed")
            if state is Landed.TAKEOFF:
                craft.say(Severity.INFO, "Takeoff detected")
        # A client has this time to take off by the wall clock.
        values, stretch = self.parameters.values, max(1.0, self.factor)
        after = values["COM_DISARM_LAND"] if self._took_off else values["COM_DISARM_PRFLT"] * stretch
        since = self._landed_at if self._took_off else self._armed_at
        if state is Landed.ON_GROUND and since is not None and 0.0 <= after <= now - since + 1e-9:
            self.disarm("Disarmed by landing" if self._took_off else "Disarmed by auto preflight disarming")

    @property
    def lands(self) -> bool:
        """Whether the vehicle is descending in order to land."""
        mode = self.mode
        return (
            mode is Mode.LAND
            or ((mode in BY_STICKS or self._loiters) and self.by_sticks.lands)
            or (mode is Mode.RTL and self._return.lands)
            or (mode is Mode.MISSION and self.plan.lands)
        )

    # ---- arming ----

    def arm(self, force: bool = False) -> Result:
        """Arm, or send clients the reasons against it and return the refusal; ``force`` skips the checks."""
        craft = self.craft
        if self.armed:
            return Result.ACCEPTED
        reasons = self.checks.reasons(craft)
        if force and not (craft.seen.stopped or craft.terminated):
            reasons = []
        if not reasons and self.mode is Mode.OFFBOARD and not self.fresh():
            reasons = ["offboard without set-points"]
        if not reasons and self.mode in BY_STICKS and not self._has_sticks:
            reasons = ["no manual control input"]
        if reasons:
            ardupilot = self.flavour.name == "ardupilot"
            if not ardupilot:
                craft.say(Severity.CRITICAL, "Arming denied: Resolve system health failures first")
            for reason in reasons:
                craft.say(Severity.CRITICAL, f"{'PreArm' if ardupilot else 'Preflight Fail'}: {reason}")
            return Result.FAILED if ardupilot else Result.TEMPORARILY_REJECTED
        self.armed, self._armed_at, self._landed_at = True, craft.seen.time, None
        self._took_off = craft.flies = not craft.seen.on_ground
        craft.critical = False
        craft.home_here()
        self.failsafes.armed()
        craft.yaw = craft.seen.attitude[2]
        craft.path.shift(craft.seen.position_ned)
        if self.mode in (Mode.RTL, Mode.LAND):
            self.switch(Mode.HOLD)
        elif self.mode is Mode.MISSION:
            self.plan.begin(craft)
        elif self.mode in BY_SETPOINTS:
            self.offboard.begin(craft)
        elif self.mode in BY_STICKS:
            self.by_sticks.begin(craft)
        elif self._goal is not None:
            here = craft.seen.position_ned
            self._goal = (here[0], here[1], self._goal[2])
        craft.tell("armed", 1)
        craft.say(Severity.INFO, "Armed by external command")
        return Result.ACCEPTED

    def disarm(self, why: str) -> None:
        """Stop the motors, even in flight, and change to the mode HOLD; ``why`` is a text for clients."""
        craft = self.craft
        if not self.armed:
            return
        self.armed, craft.critical = False, False
        craft.cruise = craft.climb = craft.sink = None
        if self.mode is not Mode.HOLD:
            self.switch(Mode.HOLD)
        self._goal, self._landed_at = None, None
        if craft.landed is not Landed.ON_GROUND:
            craft.landed = Landed.ON_GROUND
            craft.tell("landed")
        craft.tell("armed", 0)
        if why:
            craft.say(Severity.INFO, why)

    @property
    def on_ground(self) -> bool:
        """Whether the vehicle's reported landed state is "on the ground"."""
        return self.craft.landed is Landed.ON_GROUND

    # ---- modes ----

    def request_number(self, custom_mode: int) -> Result:
        """Change to the mode numbered ``custom_mode``, or send clients the reason against it; return the result."""
        mode = self.flavour.mode_of(custom_mode)
        return self.refuse_mode(custom_mode, "not flown here") if mode is None else self.request(mode)

    def request(self, mode: Mode) -> Result:
        """Change to a flight mode for a client, or send clients the reason against it; return the result."""
        craft = self.craft
        # ArduPilot's Copter takes any mode while it is disarmed, and is not armed in one that it cannot fly.
        free = self.flavour.name == "ardupilot" and not self.armed
        if mode in BY_STICKS and not (self._has_sticks or free):
            return self.refuse_mode(self.flavour.numbers[mode], "no manual control input")
        if mode is Mode.ORBIT:
            if not (self.armed and craft.flies):
                return self.refuse_mode(self.flavour.numbers[mode], "not in the air")
            self.orbit = Orbit.ahead(craft)
        if mode is Mode.MISSION and (not self.plan.items or self.plan.why_not(craft)):
            if not self.plan.items:
                craft.say(Severity.CRITICAL, "Mission rejected: no mission")
            return Result.TEMPORARILY_REJECTED
        if mode is Mode.OFFBOARD and not self.fresh():
            craft.say(Severity.CRITICAL, "Offboard rejected: no set-points")
            return Result.TEMPORARILY_REJECTED
        wanted, guided = (Mode.HOLD, True) if mode is Mode.GUIDED else (mode, False)
        if wanted is self.mode and guided == self.guided:
            return Result.ACCEPTED
        self.guided = guided
        craft.critical = False
        self.switch(wanted)
        return Result.ACCEPTED

    def refuse_mode(self, custom_mode: int, why: str) -> Result:
        """Send clients the refusal of a flight mode in PX4's or ArduPilot's words, and return the result of it."""
        self.craft.say(Severity.CRITICAL, self.flavour.refusal(custom_mode, why))
        return Result.TEMPORARILY_REJECTED if self.flavour.name == "px4" else Result.FAILED

    def switch(self, mode: Mode, goal: Triple | None = None) -> None:
        """Change the flight mode without checks; ``goal`` NED [m] is the position for HOLD or TAKEOFF."""
        craft, before = self.craft, self.mode
        self.mode, self._goal, self._meant = mode, goal, (mode, self.guided)
        if self._landed_at is not None and mode in FLIES_AGAIN:
            # It has landed, and is to fly again.
            self._took_off, self._armed_at, self._landed_at = False, craft.seen.time, None
        if before is Mode.MISSION and mode is not Mode.MISSION:
            self.plan.pause(craft)
        if mode is Mode.MISSION:
            if self.armed:
                self.plan.begin(craft)
        elif mode is Mode.RTL:
            self._return.begin(craft, self.rally)
        elif mode in BY_SETPOINTS:
            self.offboard.begin(craft)
            if mode is Mode.NOGPS:
                self.offboard.level(craft)
        elif mode is Mode.FOLLOW:
            self.follow.begin(craft)
        elif mode in BY_STICKS:
            self.by_sticks.begin(craft)
        else:
            craft.begin_path()
        if mode in (Mode.LAND, Mode.HOLD):
            self._descent.begin()
        if mode is Mode.LAND:
            self._goal = craft.path.stop(self.parameters["MPC_ACC_HOR"])
        craft.tell("mode")

    def fresh(self) -> bool:
        """Return whether the last set-point is younger than the parameter COM_OF_LOSS_T [s]."""
        return self.offboard.fresh(self.craft, self.parameters["COM_OF_LOSS_T"] * max(1.0, self.factor))

    def _fail_over(self, asked: int) -> None:
        """Take a failsafe action (``asked``), unless the present mode is at least as drastic."""
        craft = self.craft
        if asked == TERMINATE:
            self.terminate()
        elif asked == DISARM:
            self.disarm("Disarmed by failsafe")
        elif asked == HOLD and self.mode is Mode.OFFBOARD and self.guided and not self.fresh():
            # ArduPilot's GUIDED holds without set-points, and is no failsafe.
            self.switch(Mode.HOLD)
        elif asked > grave.GRAVITY_OF.get(self.mode, NOTHING):
            craft.critical, self.guided = True, False
            mode, meant = grave.MODE_OF[asked], self._meant
            craft.say(Severity.CRITICAL, f"Failsafe activated: {mode.value}")
            self.switch(mode)
            self._meant = meant

    def terminate(self) -> None:
        """End the flight: motors off until a reboot."""
        self.craft.terminated = True
        self.craft.say(Severity.EMERGENCY, "Flight termination")
        self.disarm("")
