"""What a flight stack is handed and what it gives: sights, commands, set-points, plans, orders, texts and events.

Numbers are those of ``codes``; angles of places are degrees, all others radians. A parameter that is NaN is one that
was not set.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.codes import (
    QUADROTOR,
    UNSET_INT,
    PlanKind,
    PlanResult,
    Result,
    Severity,
)
from qrsim.links.mavlink.stack.statuses import FenceStatus, Health, Heartbeat, MissionStatus, ModeInfo, OrbitStatus
from qrsim.models.scene.zone import Zone
from qrsim.scenarios.plans.heights import GroundDown

if TYPE_CHECKING:
    from qrsim.links.mavlink.stack.parameters import Parameters

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]
FlavourName = Literal["px4", "ardupilot"]
# Where the local frame of a vehicle begins: where it was when its estimator began, or at the scenario's site.
LocalOrigin = Literal["start", "site"]
# What altitudes are measured from: mean sea level, the geoid EGM96, or the WGS-84 ellipsoid.
Datum = Literal["sea", "ellipsoid"]
NAN = math.nan
# Kinds of orders by which a stack flies a vehicle itself.
NEEDED = frozenset({"path", "velocity", "attitude"})


@dataclass(frozen=True)
class Facts:
    """What a stack knows of its vehicle and its controller.

    Attributes:
        name: of the vehicle, for its orders.
        system: its MAVLink system id.
        time_step: of its ticks [s].
        kinds: of orders that it takes, names of ``links/shared/kinds.py``; a stack that flies it needs ``NEEDED``.
        mav_type: its MAV_TYPE.
        hover_throttle: throttle that carries its weight, 0 to 1.
        tilt_max: largest tilt that it can be commanded [rad].
        roll_gain, pitch_gain: settled tilt per commanded tilt.
        speed_limit: largest horizontal speed that its controller asks for [m/s].
        climb_limit, sink_limit: largest vertical speeds up and down, of its controller [m/s].
        has_battery: whether it carries a battery that drains.
        zones: zones of the scenario's area to stay in and out of; empty: none.
        z_min, z_max: ceiling and floor of that area, positions down [m].
        airspeed, airspeed_min: of a fixed wing, that of its controller and that of its stall [m/s].
        loiter_radius: of the circles of a fixed wing [m]; 0: no fixed wing.
        local_origin: where its local frame begins.
        ground_down: returns the down coordinate of the ground (...) at places north and east (...) [m]; None: it is the
            plane z = 0.
        datum: what altitudes of messages are measured from; "above mean sea level" here means above that.
    """

    name: str
    system: int = 1
    time_step: float = 0.02
    kinds: frozenset[str] = NEEDED
    mav_type: int = QUADROTOR
    hover_throttle: float = 0.5
    tilt_max: float = 0.9
    roll_gain: float = 1.0
    pitch_gain: float = 1.0
    speed_limit: float = 8.0
    climb_limit: float = 3.0
    sink_limit: float = 1.5
    has_battery: bool = False
    zones: tuple[Zone, ...] = ()
    z_min: float = -math.inf
    z_max: float = math.inf
    airspeed: float = 0.0
    airspeed_min: float = 0.0
    loiter_radius: float = 0.0
    local_origin: LocalOrigin = "start"
    ground_down: GroundDown | None = None
    datum: Datum = "sea"


@dataclass(slots=True)
class Seen:
    """What a vehicle sees of itself at a tick; one object may be filled again at every tick.

    Attributes:
        time: simulated, since the reset [s].
        position_ned, velocity_ned: estimate in the site's frame [m], [m/s].
        attitude: estimate, roll, pitch, yaw [rad].
        rates: body rates [rad/s].
        valid: whether there is an estimate: all its numbers are finite.
        fix_type: GPS_FIX_TYPE, 3 and more is a position in three dimensions; 0 without a receiver.
        horizontal_accuracy, vertical_accuracy: as the receiver says [m]; NaN where it does not.
        latitude, longitude: of the estimate [deg].
        altitude: of the estimate above mean sea level [m].
        charge: of the battery, 0 to 1; NaN without one.
        voltage: of it [V].
        on_ground: whether it stands on the ground.
        stopped: why its flight has ended, "" while it has not.
        present, healthy: sensors that it carries, and those that work.
    """

    time: float = 0.0
    position_ned: Triple = (0.0, 0.0, 0.0)
    velocity_ned: Triple = (0.0, 0.0, 0.0)
    attitude: Triple = (0.0, 0.0, 0.0)
    rates: Triple = (0.0, 0.0, 0.0)
    valid: bool = True
    fix_type: int = 3
    horizontal_accuracy: float = NAN
    vertical_accuracy: float = NAN
    latitude: float = 0.0
    longitude: float = 0.0
    altitude: float = 0.0
    charge: float = NAN
    voltage: float = NAN
    on_ground: bool = True
    stopped: str = ""
    present: int = 0
    healthy: int = 0

    @property
    def end(self) -> str:
        """Return the text that refuses commands to a vehicle whose flight has ended."""
        return f"flight has ended: {self.stopped}; reboot"


@dataclass(frozen=True, slots=True)
class Command:
    """A COMMAND_LONG or COMMAND_INT.

    Attributes:
        id: MAV_CMD.
        params: its seven numbers; of a place the fifth and sixth are degrees, for COMMAND_INT too.
        frame: MAV_FRAME of a COMMAND_INT; 0, altitudes above mean sea level, of a COMMAND_LONG.
        is_int: whether it came as COMMAND_INT.
    """

    id: int
    params: tuple[float, float, float, float, float, float, float] = (NAN,) * 7
    frame: int = 0
    is_int: bool = False

    @staticmethod
    def of_int(id: int, frame: int, params: Quadruple, x: int, y: int, z: float) -> Command:
        """Convert a COMMAND_INT to a Command: x and y, degrees times 1e7, become degrees; 2**31 - 1 (unset) becomes
        NaN."""
        place = [NAN if number == UNSET_INT else number * 1e-7 for number in (x, y)]
        return Command(id, (*params, place[0], place[1], z), frame, True)


@dataclass(frozen=True, slots=True)
class Ack:
    """What COMMAND_ACK says: the result, and its progress [%] while it is IN_PROGRESS."""

    result: Result
    progress: int = 0


@dataclass(frozen=True, slots=True)
class LocalTarget:
    """SET_POSITION_TARGET_LOCAL_NED: numbers that ``mask`` ignores may be anything.

    Attributes:
        frame: MAV_FRAME 1 local (from ``Stack.origin``), 7 offset from here, 8 and 9 along the heading.
        mask: POSITION_TARGET_TYPEMASK.
    """

    frame: int
    mask: int
    position: Triple = (NAN, NAN, NAN)
    velocity: Triple = (NAN, NAN, NAN)
    acceleration: Triple = (NAN, NAN, NAN)
    yaw: float = NAN
    yaw_rate: float = NAN


@dataclass(frozen=True, slots=True)
class GlobalTarget:
    """SET_POSITION_TARGET_GLOBAL_INT, latitude and longitude in degrees times 1e7; frames 0, 3, 5, 6, 10, 11."""

    frame: int
    mask: int
    lat_int: int
    lon_int: int
    alt: float
    velocity: Triple = (NAN, NAN, NAN)
    acceleration: Triple = (NAN, NAN, NAN)
    yaw: float = NAN
    yaw_rate: float = NAN


@dataclass(frozen=True, slots=True)
class AttitudeTarget:
    """SET_ATTITUDE_TARGET: quaternion w, x, y, z from body to NED, body rates [rad/s], thrust 0 to 1."""

    mask: int
    q: Quadruple
    rates: Triple
    thrust: float


Target = LocalTarget | GlobalTarget | AttitudeTarget


@dataclass(frozen=True, slots=True)
class FollowTarget:
    """FOLLOW_TARGET: degrees, altitude above mean sea level [m], velocity NED [m/s]."""

    latitude: float
    longitude: float
    altitude: float
    velocity: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Item:
    """One item of a plan, as in MISSION_ITEM_INT: x and y are degrees times 1e7 in a global frame.

    Of a MISSION_ITEM of floats, x and y are its degrees times 1e7, rounded; 2**31 - 1 where they are NaN.
    """

    seq: int
    frame: int
    command: int
    params: Quadruple = (NAN, NAN, NAN, NAN)
    x: int = 0
    y: int = 0
    z: float = 0.0
    autocontinue: int = 1


@dataclass(frozen=True, slots=True)
class Home:
    """Where a vehicle returns to: degrees, altitude above mean sea level [m], and in the site's frame [m]."""

    latitude: float
    longitude: float
    altitude: float
    position_ned: Triple
    yaw: float = 0.0


@dataclass(frozen=True, slots=True)
class Text:
    """A STATUSTEXT; longer than 50 characters it goes out in chunks."""

    severity: Severity
    text: str


EventKind = Literal["item_reached", "mission", "landed", "mode", "armed", "home", "fence", "plan", "reboot"]


@dataclass(frozen=True, slots=True)
class Event:
    """Something that changed, which clients are told at once.

    Attributes:
        kind: "item_reached" (number: its seq; MISSION_ITEM_REACHED), "mission" (MISSION_CURRENT, see
            ``Stack.mission``), "landed" (EXTENDED_SYS_STATE), "mode" and "armed" (HEARTBEAT), "home" (HOME_POSITION),
            "fence" (FENCE_STATUS), "plan" (number: PlanKind; it was replaced), "reboot".
        number: what belongs to it.
    """

    kind: EventKind
    number: int = 0


class Stack(Protocol):
    """The flight stack of one vehicle, as a server uses it (``flight_stack.FlightStack``).

    Attributes:
        parameters: its table; whatever was set holds from the next tick on.
        factor: simulated seconds per second of wall time, for time-outs against a peer.
        armed: whether its motors may turn.
        takes_setpoints: whether clients can fly it.
    """

    parameters: Parameters
    factor: float
    armed: bool
    takes_setpoints: bool

    @property
    def home(self) -> Home | None:
        """Position to which the vehicle returns; None before the first position estimate."""

    @property
    def origin(self) -> Triple:
        """Origin of the vehicle's local frame (of its MAVLink messages), in the site's frame NED [m]."""

    def place(self, position_ned: Triple) -> Triple:
        """Convert a position NED [m] in the site's frame to latitude, longitude [deg] and altitude above mean sea level
        [m]."""

    def tick(self, seen: Seen) -> Order | None:
        """Advance by one tick with the vehicle's present state; return its new order, or None to keep the last one."""

    def reset(self) -> None:
        """Restart as after a boot: disarmed, time 0; parameters and plans stay."""

    def command(self, command: Command) -> Ack:
        """Execute or refuse a command of flight or mission; requests for messages are handled elsewhere."""

    def set_mode(self, base_mode: int, custom_mode: int) -> Result:
        """Change the flight mode as a SET_MODE message asks, or refuse it."""

    def setpoint(self, target: Target) -> bool:
        """Store a client's set-point for the mode OFFBOARD (GUIDED); return whether it can be flown."""

    def sticks(self, roll: float, pitch: float, throttle: float, yaw: float) -> None:
        """Store stick positions, each -1 to 1, positive right, forwards, up and clockwise; NaN keeps the last one."""

    def follow_target(self, target: FollowTarget) -> None:
        """Store the position of the moving target that the mode FOLLOW_TARGET follows."""

    def modes(self) -> tuple[ModeInfo, ...]:
        """Return the vehicle's flight modes: those that clients can request, and those that only failsafes use."""

    def current_modes(self) -> tuple[ModeInfo, ModeInfo]:
        """Return the mode that is flown and the mode that was requested; they differ in a failsafe."""

    def orbiting(self) -> OrbitStatus | None:
        """Return the orbit that the vehicle flies now, None while it flies none."""

    def go_to(self, item: Item) -> bool:
        """Fly to a waypoint at once, in ArduPilot's GUIDED mode; return whether this flight stack does so."""

    def change_altitude(self, item: Item) -> None:
        """Change the altitude to that of an ArduPilot guided item; only fixed wings obey."""

    def accept(self, kind: PlanKind, items: Sequence[Item]) -> tuple[PlanResult, int]:
        """Replace the plan of a kind, unless an item is invalid; return the result, and the invalid item's sequence
        number or -1."""

    def items(self, kind: PlanKind) -> tuple[Item, ...]:
        """Return the items of the stored plan of a kind (mission, fence, rally)."""

    def thrust_of(self, throttle: float) -> float:
        """Convert a throttle to PX4's normalised thrust, both 0 to 1; hover throttle gives ``MPC_THR_HOVER``."""

    def home_item(self) -> Item | None:
        """Return home as item 0 of ArduPilot's mission; None without a home, and always for PX4."""

    def set_current(self, seq: int) -> bool:
        """Make the mission item with sequence number ``seq`` the current one; return whether it exists."""

    def heard_ground(self) -> None:
        """Note that a ground station's heartbeat (MAV_TYPE 6) has arrived."""

    def heartbeat(self) -> Heartbeat:
        """Return the fields of HEARTBEAT and EXTENDED_SYS_STATE."""

    def health(self) -> Health:
        """Return the sensor bit masks of SYS_STATUS: present, enabled and healthy."""

    def mission(self) -> MissionStatus:
        """Return the fields of MISSION_CURRENT: the present item and the mission's state."""

    def fence(self) -> FenceStatus:
        """Return the fields of FENCE_STATUS: whether the fence is breached, how often, and how."""

    def texts(self) -> list[Text]:
        """Return the status texts queued since the last call, and empty the queue."""

    def events(self) -> list[Event]:
        """Return the events queued since the last call, and empty the queue."""
