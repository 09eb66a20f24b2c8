"""Numbers of MAVLink's ``common`` dialect that a flight stack speaks: results, states, severities, sensors, types."""

from __future__ import annotations

from enum import IntEnum, IntFlag

# MAV_TYPE.
FIXED_WING, QUADROTOR, GROUND_ROVER, HEXAROTOR, OCTOROTOR = 1, 2, 10, 13, 14
# MAV_AUTOPILOT.
ARDUPILOT, PX4 = 3, 12
# x or y of an integer message that is not set.
UNSET_INT = 2**31 - 1


class Result(IntEnum):
    """MAV_RESULT: the answer to a command."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5
    CANCELLED = 6


class PlanResult(IntEnum):
    """MAV_MISSION_RESULT: the answer to a plan."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM1 = 6
    INVALID_PARAM2 = 7
    INVALID_PARAM3 = 8
    INVALID_PARAM4 = 9
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    CANCELLED = 15


class PlanKind(IntEnum):
    """MAV_MISSION_TYPE."""

    MISSION = 0
    FENCE = 1
    RALLY = 2


class MissionState(IntEnum):
    """MISSION_STATE of MISSION_CURRENT."""

    NO_MISSION = 1
    NOT_STARTED = 2
    ACTIVE = 3
    PAUSED = 4
    COMPLETE = 5


class Landed(IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class Breach(IntEnum):
    """FENCE_BREACH: what of a fence was breached."""

    NONE = 0
    FLOOR = 1
    CEILING = 2
    BOUNDARY = 3


class Severity(IntEnum):
    """MAV_SEVERITY of a STATUSTEXT."""

    EMERGENCY = 0
    ALERT = 1
    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class Sensor(IntFlag):
    """MAV_SYS_STATUS_SENSOR: the bits of SYS_STATUS that the stack looks at or sets."""

    GYRO = 0x1
    ACCELEROMETER = 0x2
    MAGNETOMETER = 0x4
    BAROMETER = 0x8
    GPS = 0x20
    GEOFENCE = 0x100000
    AHRS = 0x200000
    BATTERY = 0x2000000
    PREARM = 0x10000000
