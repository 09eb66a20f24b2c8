"""The flight stack of one vehicle: what clients ask of it, and what it tells them."""

from __future__ import annotations

from collections.abc import Sequence

from qrsim.links.mavlink.stack.codes import PlanKind, PlanResult, Result, Sensor, Severity
from qrsim.links.mavlink.stack.commands import REPOSITION, obey
from qrsim.links.mavlink.stack.contracts import (
    NAN,
    Ack,
    AttitudeTarget,
    Command,
    Event,
    Facts,
    FlavourName,
    FollowTarget,
    Home,
    Item,
    Target,
    Text,
    Triple,
)
from qrsim.links.mavlink.stack.fence import Fence, items_of, rally_points
from qrsim.links.mavlink.stack.flight import Flight
from qrsim.links.mavlink.stack.modes import ARMED_FLAG, Mode
from qrsim.links.mavlink.stack.parameters import Parameters
from qrsim.links.mavlink.stack.statuses import FenceStatus, Health, Heartbeat, MissionStatus, ModeInfo, OrbitStatus
from qrsim.models.site import Site
from qrsim.scenarios.plans.commands import WAYPOINT

# Automatic modes, which sticks that move take over from.
OVERRIDDEN = frozenset((Mode.HOLD, Mode.TAKEOFF, Mode.MISSION, Mode.RTL, Mode.LAND, Mode.FOLLOW))
# As plain numbers, because operators of a flag take ten times as long.
_BATTERY, _PREARM, _AHRS, _GEOFENCE = map(int, (Sensor.BATTERY, Sensor.PREARM, Sensor.AHRS, Sensor.GEOFENCE))
# MAV_STATE.
STANDBY, ACTIVE, CRITICAL, TERMINATION = 3, 4, 5, 8


class FlightStack(Flight):
    """See ``contracts.Stack``; the arguments are those of ``Flight``."""

    takes_setpoints: bool = True

    def __init__(
        self,
        facts: Facts,
        site: Site,
        parameters: Parameters | None = None,
        flavour: FlavourName = "px4",
        factor: float = 1.0,
    ):
        super().__init__(facts, site, parameters, flavour, factor)
        self._fence_items = items_of(facts.zones, self.craft.geodesy)
        self._heartbeat = Heartbeat(self.flavour.autopilot, mav_type=facts.mav_type)

    # ---- what clients ask ----

    def place(self, position_ned: Triple) -> Triple:
        """Convert a position NED [m] in the site's frame to latitude, longitude [deg] and altitude above mean sea level
        [m]."""
        return self.craft.geodesy.to_geodetic(position_ned)

    def command(self, command: Command) -> Ack:
        """Execute or refuse a command of flight or mission; requests for messages are handled elsewhere."""
        return Ack(obey(self, command))

    def set_mode(self, base_mode: int, custom_mode: int) -> Result:
        """Change the flight mode as a SET_MODE message asks, or refuse it; without the custom-mode flag it is
        refused."""
        if not base_mode & 1:
            return Result.UNSUPPORTED
        return self.request_number(custom_mode)

    def setpoint(self, target: Target) -> bool:
        """Store a client's set-point for the mode OFFBOARD (GUIDED); return whether it can be flown."""
        why = self.craft.seen.end if self.craft.seen.stopped else ""
        if self.mode is Mode.NOGPS and not isinstance(target, AttitudeTarget):
            why = "GUIDED_NOGPS flies attitudes alone"
        if why:
            return self.offboard.refuse(self.craft, why)
        taken = self.offboard.take(target, self.craft)
        # Programs send the first place at 95 % of the height of a take-off.
        if taken and self.guided and (self.mode is Mode.HOLD or (self.mode is Mode.TAKEOFF and self.craft.flies)):
            self.switch(Mode.OFFBOARD)
        return taken

    def sticks(self, roll: float, pitch: float, throttle: float, yaw: float) -> None:
        """Store stick positions, each -1 to 1, positive right, forwards, up and clockwise; NaN keeps the last one."""
        moved = self.by_sticks.take((roll, pitch, throttle, yaw), self.craft)
        overrides = self.flavour.name == "px4" and int(self.parameters["COM_RC_OVERRIDE"]) & 1
        automatic = self.armed and self.craft.flies and self.mode in OVERRIDDEN
        if moved and overrides and automatic and Mode.POSITION in self.flavour.modes:
            self.craft.say(Severity.INFO, "Pilot took over using sticks")
            self.switch(Mode.POSITION)

    def follow_target(self, target: FollowTarget) -> None:
        """Store the position of the moving target that the mode FOLLOW_TARGET follows."""
        self.follow.take(target, self.craft)

    def modes(self) -> tuple[ModeInfo, ...]:
        """Return the vehicle's flight modes: those that clients can request, and those that only failsafes use."""
        return self.flavour.infos()

    def current_modes(self) -> tuple[ModeInfo, ModeInfo]:
        """Return the mode that is flown and the mode that was requested; they differ in a failsafe."""
        return self.flavour.info(self.mode, self.guided), self.flavour.info(*self._meant)

    def orbiting(self) -> OrbitStatus | None:
        """Return the orbit that the vehicle flies now, None while it flies none."""
        return OrbitStatus(self.orbit.radius, self.orbit.centre) if self.mode is Mode.ORBIT else None

    def thrust_of(self, throttle: float) -> float:
        """Convert a throttle to PX4's normalised thrust, both 0 to 1; hover throttle gives ``MPC_THR_HOVER``."""
        return self.craft.thrust_of(throttle)

    def _refuse(self, what: str, why: str) -> None:
        """Send clients a warning "WHAT denied: WHY"."""
        self.craft.say(Severity.WARNING, f"{what} denied: {why}")

    def go_to(self, item: Item) -> bool:
        """Fly to a waypoint at once, in ArduPilot's GUIDED mode; return whether this flight stack does so."""
        if item.command != WAYPOINT or not self.guided:
            self.craft.say(Severity.WARNING, "Guided item rejected: a waypoint, in GUIDED, is needed")
            return False
        place = Command.of_int(REPOSITION, item.frame, (-1.0, 1.0, NAN, NAN), item.x, item.y, item.z)
        return self.command(place).result is Result.ACCEPTED

    def change_altitude(self, item: Item) -> None:
        """Warn clients that an ArduPilot guided item with only an altitude is ignored, as Copter and Rover do."""
        self.craft.say(Severity.INFO, "Change of altitude ignored, as by ArduPilot's Copter: fly to a place instead")

    def heard_ground(self) -> None:
        """Note that a ground station's heartbeat (MAV_TYPE 6) has arrived."""
        self.failsafes.heard_ground(self.craft)

    # ---- plans ----

    def accept(self, kind: PlanKind, items: Sequence[Item]) -> tuple[PlanResult, int]:
        """Replace the plan of a kind, unless an item is invalid; return the result, and the invalid item's sequence
        number or -1."""
        craft = self.craft
        if kind is PlanKind.MISSION:
            result, bad = self.plan.accept(items, craft)
            if result is PlanResult.ACCEPTED and self.mode is Mode.MISSION:
                self.switch(Mode.MISSION if items and not self.plan.why_not(craft) else Mode.HOLD)
        elif kind is PlanKind.FENCE:
            fence, result, bad = Fence.of(items, craft.geodesy, craft.area)
            if result is PlanResult.ACCEPTED:
                craft.fence, self._fence_items = fence, tuple(items)
                if self.plan.items:
                    self.plan.why_not(craft)
        else:
            result, bad = rally_points(items)
            if result is PlanResult.ACCEPTED:
                self.rally = tuple(items)
        if result is PlanResult.ACCEPTED:
            craft.tell("plan", int(kind))
        else:
            craft.say(Severity.WARNING, f"{kind.name.capitalize()} refused at item {bad}: {result.name.lower()}")
        return result, bad

    def items(self, kind: PlanKind) -> tuple[Item, ...]:
        """Return the items of the stored plan of a kind; until a fence is uploaded, that of the scenario."""
        return {PlanKind.MISSION: self.plan.items, PlanKind.FENCE: self._fence_items, PlanKind.RALLY: self.rally}[kind]

    def home_item(self) -> Item | None:
        """Return home as item 0 of ArduPilot's mission; None without a home, and always for PX4."""
        home = self.craft.home
        if self.flavour.name != "ardupilot" or home is None:
            return None
        # In ArduPilot's frame of it, above mean sea level.
        place = round(home.latitude * 1e7), round(home.longitude * 1e7)
        return Item(0, 0, WAYPOINT, (0.0, 0.0, 0.0, 0.0), *place, home.altitude)

    def set_current(self, seq: int) -> bool:
        """Make the mission item with sequence number ``seq`` the current one; return whether it exists."""
        return self.plan.set_current(seq, self.craft)

    # ---- what it says ----

    @property
    def home(self) -> Home | None:
        """Position to which the vehicle returns; None before the first position estimate."""
        return self.craft.home

    @property
    def origin(self) -> Triple:
        """Origin of the vehicle's local frame (of its MAVLink messages), in the site's frame NED [m]."""
        return self.craft.origin

    def heartbeat(self) -> Heartbeat:
        """Return the fields of HEARTBEAT and EXTENDED_SYS_STATE."""
        told, craft = self._heartbeat, self.craft
        told.base_mode = self.flavour.flags(self.mode) | (ARMED_FLAG if self.armed else 0)
        told.custom_mode = self.flavour.custom_mode(self.mode, self.guided)
        told.landed = craft.landed
        told.system_status = ACTIVE if self.armed else STANDBY
        if craft.terminated:
            told.system_status = TERMINATION
        elif self.armed and craft.critical:
            told.system_status = CRITICAL
        return told

    def health(self) -> Health:
        """Return the sensor bit masks of SYS_STATUS: present, enabled and healthy."""
        craft, seen = self.craft, self.craft.seen
        reasons = [] if self.armed else self.checks.reasons(craft)
        battery = _BATTERY if seen.charge == seen.charge else 0
        # MAVProxy takes a fence that is not enabled for a breach.
        present = _PREARM | _AHRS | _GEOFENCE | battery
        healthy = 0 if reasons else _PREARM
        healthy |= _AHRS if seen.valid else 0
        healthy |= 0 if self.failsafes.breached else _GEOFENCE
        healthy |= battery if seen.charge > self.parameters["BAT_CRIT_THR"] else 0
        return Health(present, present, healthy, reasons)

    def mission(self) -> MissionStatus:
        """Return the fields of MISSION_CURRENT: the present item and the mission's state."""
        return self.plan.status(self.mode is Mode.MISSION)

    def fence(self) -> FenceStatus:
        """Return the fields of FENCE_STATUS: whether the fence is breached, how often, and how."""
        return self.failsafes.fence()

    def texts(self) -> list[Text]:
        """Return the status texts queued since the last call, and empty the queue."""
        return self.craft.texts()

    def events(self) -> list[Event]:
        """Return the events queued since the last call, and empty the queue."""
        return self.craft.events()
