"""What a flight stack says of itself: statuses for the messages of a server."""

from __future__ import annotations

from dataclasses import dataclass, field

from qrsim.links.mavlink.stack.codes import PX4, QUADROTOR, Breach, Landed, MissionState


@dataclass(frozen=True, slots=True)
class ModeInfo:
    """What AVAILABLE_MODES says of a mode: numbers, MAV_STANDARD_MODE, MAV_MODE_PROPERTY, and a name if it has one."""

    custom_mode: int
    standard: int = 0
    properties: int = 0
    name: str = ""


@dataclass(frozen=True, slots=True)
class OrbitStatus:
    """What ORBIT_EXECUTION_STATUS says: radius [m], below 0 counterclockwise, and the centre NED [m]."""

    radius: float
    centre: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MissionStatus:
    """What MISSION_CURRENT says: the item that is flown, how many there are, and whether it is flown."""

    seq: int = 0
    total: int = 0
    state: MissionState = MissionState.NO_MISSION
    in_mode: bool = False


@dataclass(frozen=True, slots=True)
class FenceStatus:
    """What FENCE_STATUS says: whether the fence is breached, how often it was, by what last, and when [s]."""

    breached: bool = False
    count: int = 0
    breach: Breach = Breach.NONE
    time: float = 0.0


@dataclass(slots=True)
class Heartbeat:
    """What HEARTBEAT and EXTENDED_SYS_STATE say."""

    autopilot: int = PX4
    base_mode: int = 0
    custom_mode: int = 0
    system_status: int = 3
    landed: Landed = Landed.ON_GROUND
    mav_type: int = QUADROTOR


@dataclass
class Health:
    """Bits for SYS_STATUS beside those of the sensors in ``Seen``: ``Sensor.PREARM``, GEOFENCE, AHRS, BATTERY."""

    present: int = 0
    enabled: int = 0
    healthy: int = 0
    reasons: list[str] = field(default_factory=list)
