"""Mission commands: which are flown, by which autopilots' plans they may come, and what of them is not carried out.

One table for plan files and for plans that come over a link. Numbers and parameters are those of MAVLink's MAV_CMD
(``common`` dialect). ``by`` follows PX4's MavlinkMissionManager and FeasibilityChecker and ArduPilot's AP_Mission.
A file may have every command that one of the two takes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Kind = Literal["place", "order", "skipped", "refused"]
Words = tuple[str, str, str, str]

WAYPOINT, LOITER_FOREVER, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 17, 18, 19, 20, 21, 22
LOITER_TO_ALTITUDE, SPLINE, DELAY, CONDITION_DELAY, CONDITION_DISTANCE = 31, 82, 93, 112, 114
CONDITION_YAW, JUMP, CHANGE_SPEED, SET_HOME, LAND_START, FENCE_ENABLE, GATE = 115, 177, 178, 179, 189, 207, 4501
# MAV_FRAME: altitudes above mean sea level, above home and above the ground; the second of each pair is of integers.
ABOVE_SEA, ABOVE_HOME, ABOVE_GROUND = (0, 5), (3, 6), (10, 11)
# The frame of an item without a place.
MISSION_FRAME = 2
FRAMES = frozenset((*ABOVE_SEA, *ABOVE_HOME, *ABOVE_GROUND))
OTHER_FRAMES = {1: "LOCAL_NED", 4: "LOCAL_ENU"}
NO_VTOL = "no vehicle of qrsim changes between hovering and gliding; take fixed_wing or multirotor"
FENCE_OFF = "the area of a scenario always holds; take the item out"
_NOTHING: Words = ("", "", "", "")
_YAW = "yaw {:g} deg"


@dataclass(frozen=True)
class Command:
    """A mission command.

    Attributes:
        id: MAV_CMD.
        name: of it, without MAV_CMD.
        kind: "place": a position to fly to; "order": anything else that is carried out; "skipped": accepted without an
            effect; "refused": an error.
        words: what the first four parameters ask for; "" where nothing is defined.
        asked: index of a parameter -> field of a waypoint that it becomes; of other parameters a mission flies nothing.
        by: autopilots that take it in a plan over a link: "p" PX4, "a" ArduPilot.
        why: reason of a refusal, "" for the usual one.
    """

    id: int
    name: str
    kind: Kind
    words: Words = _NOTHING
    asked: Mapping[int, str] = field(default_factory=dict)
    by: str = "pa"
    why: str = ""


# Multicopters do not circle but stay where they loiter for a time or for ever, so that these radii are not flown.
_CARRIED_OUT = (
    Command(
        WAYPOINT,
        "NAV_WAYPOINT",
        "place",
        ("hold for {:g} s", "acceptance radius {:g} m", "pass at {:g} m", _YAW),
        {0: "hold", 1: "accept_radius", 3: "yaw_deg"},
    ),
    Command(LOITER_FOREVER, "NAV_LOITER_UNLIM", "place", ("", "", "loiter radius {:g} m", _YAW), {3: "yaw_deg"}),
    Command(
        LOITER_TURNS,
        "NAV_LOITER_TURNS",
        "place",
        ("{:g} turns", "", "loiter radius {:g} m", ""),
        {0: "turns", 2: "radius"},
    ),
    Command(
        LOITER_TIME, "NAV_LOITER_TIME", "place", ("loiter for {:g} s", "", "loiter radius {:g} m", ""), {0: "hold"}
    ),
    Command(RETURN, "NAV_RETURN_TO_LAUNCH", "order"),
    Command(
        LAND, "NAV_LAND", "place", ("abort altitude {:g} m", "precision landing mode {:g}", "", _YAW), {3: "yaw_deg"}
    ),
    Command(TAKEOFF, "NAV_TAKEOFF", "place", ("pitch {:g} deg", "", "", _YAW), {3: "yaw_deg"}),
    Command(LOITER_TO_ALTITUDE, "NAV_LOITER_TO_ALT", "place", ("", "loiter radius {:g} m", "", "")),
    Command(SPLINE, "NAV_SPLINE_WAYPOINT", "place", ("hold for {:g} s", "", "", ""), {0: "hold"}, by="a"),
    Command(DELAY, "NAV_DELAY", "order"),
    Command(CONDITION_DELAY, "CONDITION_DELAY", "order"),
    Command(CONDITION_DISTANCE, "CONDITION_DISTANCE", "order", by="a"),
    Command(CONDITION_YAW, "CONDITION_YAW", "order", by="a"),
    Command(JUMP, "DO_JUMP", "order"),
    Command(CHANGE_SPEED, "DO_CHANGE_SPEED", "order"),
    Command(SET_HOME, "DO_SET_HOME", "order"),
    Command(GATE, "CONDITION_GATE", "order", by="p"),
)
# Cameras, gimbals, regions of interest, servos, relays, grippers, winches and markers.
_SKIPPED = {
    80: "NAV_ROI", 187: "DO_SET_ACTUATOR", 189: "DO_LAND_START", 195: "DO_SET_ROI_LOCATION",
    196: "DO_SET_ROI_WPNEXT_OFFSET", 197: "DO_SET_ROI_NONE", 200: "DO_CONTROL_VIDEO", 201: "DO_SET_ROI",
    203: "DO_DIGICAM_CONTROL", 204: "DO_MOUNT_CONFIGURE", 205: "DO_MOUNT_CONTROL", 206: "DO_SET_CAM_TRIGG_DIST",
    211: "DO_GRIPPER", 212: "DO_AUTOTUNE_ENABLE", 214: "DO_SET_CAM_TRIGG_INTERVAL", 260: "OBLIQUE_SURVEY",
    530: "SET_CAMERA_MODE", 531: "SET_CAMERA_ZOOM", 532: "SET_CAMERA_FOCUS", 534: "SET_CAMERA_SOURCE",
    1000: "DO_GIMBAL_MANAGER_PITCHYAW", 1001: "DO_GIMBAL_MANAGER_CONFIGURE", 2000: "IMAGE_START_CAPTURE",
    2001: "IMAGE_STOP_CAPTURE", 2003: "DO_TRIGGER_CONTROL", 2500: "VIDEO_START_CAPTURE", 2501: "VIDEO_STOP_CAPTURE",
    2502: "VIDEO_START_STREAMING", 2503: "VIDEO_STOP_STREAMING", 42600: "DO_WINCH",
}  # fmt: skip
_SKIPPED_OF_ARDUPILOT = {
    181: "DO_SET_RELAY",
    182: "DO_REPEAT_RELAY",
    183: "DO_SET_SERVO",
    184: "DO_REPEAT_SERVO",
    202: "DO_DIGICAM_CONFIGURE",
    FENCE_ENABLE: "DO_FENCE_ENABLE",
    216: "DO_SPRAYER",
}
_VTOL = {84: "NAV_VTOL_TAKEOFF", 85: "NAV_VTOL_LAND", 3000: "DO_VTOL_TRANSITION"}
# Named in messages.
_REFUSED = {
    92: "NAV_GUIDED_ENABLE",
    94: "NAV_PAYLOAD_PLACE",
    113: "CONDITION_CHANGE_ALT",
    176: "DO_SET_MODE",
    208: "DO_PARACHUTE",
    222: "DO_GUIDED_LIMITS",
    300: "MISSION_START",
}
COMMANDS: dict[int, Command] = {
    each.id: each
    for each in (
        *_CARRIED_OUT,
        *(Command(number, name, "skipped") for number, name in _SKIPPED.items()),
        *(Command(number, name, "skipped", by="a") for number, name in _SKIPPED_OF_ARDUPILOT.items()),
        *(Command(number, name, "refused", by="", why=NO_VTOL) for number, name in _VTOL.items()),
        *(Command(number, name, "refused", by="") for number, name in _REFUSED.items()),
    )
}
# Flown through, where they do not hold.
WAYPOINTS = frozenset((WAYPOINT, SPLINE))
PLACES = frozenset(number for number, each in COMMANDS.items() if each.kind == "place")
SKIPPED = frozenset(number for number, each in COMMANDS.items() if each.kind == "skipped")


def name_of(command: object) -> str:
    """Return the name of a MAV_CMD number for messages; the number itself if it is unknown."""
    known = COMMANDS.get(command) if isinstance(command, int) else None
    return known.name if known else str(command)


def flown_names() -> str:
    """Return numbers and names of all mission commands that qrsim carries out, as text for messages."""
    return ", ".join(f"{each.id} ({each.name})" for each in _CARRIED_OUT)


def taken_by(flavour: str) -> frozenset[int]:
    """Return the MAV_CMD numbers that a mission sent over MAVLink may contain; ``flavour`` is "px4" or "ardupilot"."""
    return frozenset(number for number, each in COMMANDS.items() if flavour[0] in each.by)
