"""Tables of the MAVLink that qrsim, PX4 and ArduPilot take: ``python -m docs.writers.mavlink_table [--write]``.

The column "here" is asked of the code: every command is given to a vehicle of each flavour, every plan item uploaded.
The others are written down below, from the sources of both (PX4 1.15: Commander, MavlinkReceiver,
MavlinkMissionManager, FeasibilityChecker; ArduPilot 4.5: GCS_Common, GCS_Mavlink of Copter, AP_Mission).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from qrsim.links.mavlink import dialogue, requests
from qrsim.links.mavlink.dialect import BY_NUMBER
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.stack import plan
from qrsim.links.mavlink.stack.codes import PlanResult, Result
from qrsim.links.mavlink.stack.contracts import Command, Facts, FlavourName, Item
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.stack.modes import FLAVOURS, Mode
from qrsim.links.mavlink.stack.parameters import TABLE
from qrsim.links.mavlink.streams import GROUND, Streams
from qrsim.links.mavlink.system import System
from qrsim.links.mavlink.telemetry import ENCODERS
from qrsim.models.site import Site

PAGE = Path(__file__).resolve().parents[1] / "reference" / "mavlink_compared.md"
BEGIN, END = "<!-- written by: python -m docs.writers.mavlink_table --write -->", "<!-- end of what is written -->"
BOTH: tuple[FlavourName, FlavourName] = ("px4", "ardupilot")
NONE = "-"


def _facts(text: str) -> dict[int, tuple[str, str]]:
    """Return name and takers by number, of words such as "34:DO_ORBIT:p"."""
    found = {}
    for word in text.split():
        number, name, who = word.split(":")
        found[int(number)] = name, who
    return found


# Commands and plan items: which of PX4 (p) and ArduPilot (a) take them.
COMMANDS = _facts("""
    17:NAV_LOITER_UNLIM:a 20:NAV_RETURN_TO_LAUNCH:pa 21:NAV_LAND:pa 22:NAV_TAKEOFF:pa 34:DO_ORBIT:p
    115:CONDITION_YAW:a 176:DO_SET_MODE:pa 178:DO_CHANGE_SPEED:pa 179:DO_SET_HOME:pa 181:DO_SET_RELAY:a
    183:DO_SET_SERVO:a 185:DO_FLIGHTTERMINATION:pa 187:DO_SET_ACTUATOR:p 192:DO_REPOSITION:pa
    193:DO_PAUSE_CONTINUE:a 195:DO_SET_ROI_LOCATION:pa 197:DO_SET_ROI_NONE:pa 201:DO_SET_ROI:pa
    203:DO_DIGICAM_CONTROL:pa 205:DO_MOUNT_CONTROL:pa 206:DO_SET_CAM_TRIGG_DIST:pa 207:DO_FENCE_ENABLE:a
    209:DO_MOTOR_TEST:a 211:DO_GRIPPER:pa 224:DO_SET_MISSION_CURRENT:pa 241:PREFLIGHT_CALIBRATION:pa
    245:PREFLIGHT_STORAGE:pa 246:PREFLIGHT_REBOOT_SHUTDOWN:pa 262:DO_SET_STANDARD_MODE:p 300:MISSION_START:pa
    310:ACTUATOR_TEST:p 400:COMPONENT_ARM_DISARM:pa 401:RUN_PREARM_CHECKS:pa 410:GET_HOME_POSITION:pa
    510:GET_MESSAGE_INTERVAL:pa 511:SET_MESSAGE_INTERVAL:pa 512:REQUEST_MESSAGE:pa 519:REQUEST_PROTOCOL_VERSION:p
    520:REQUEST_AUTOPILOT_CAPABILITIES:pa 530:SET_CAMERA_MODE:pa 1000:DO_GIMBAL_MANAGER_PITCHYAW:pa
    2000:IMAGE_START_CAPTURE:pa 2500:VIDEO_START_CAPTURE:pa 3000:DO_VTOL_TRANSITION:p 42600:DO_WINCH:pa
""")
ITEMS = _facts("""
    16:NAV_WAYPOINT:pa 17:NAV_LOITER_UNLIM:pa 18:NAV_LOITER_TURNS:a 19:NAV_LOITER_TIME:pa 20:NAV_RETURN_TO_LAUNCH:pa
    21:NAV_LAND:pa 22:NAV_TAKEOFF:pa 31:NAV_LOITER_TO_ALT:pa 80:NAV_ROI:p 82:NAV_SPLINE_WAYPOINT:a
    84:NAV_VTOL_TAKEOFF:p 85:NAV_VTOL_LAND:p 92:NAV_GUIDED_ENABLE:a 93:NAV_DELAY:pa 94:NAV_PAYLOAD_PLACE:a
    112:CONDITION_DELAY:a 114:CONDITION_DISTANCE:a 115:CONDITION_YAW:a 177:DO_JUMP:pa 178:DO_CHANGE_SPEED:pa
    179:DO_SET_HOME:pa 181:DO_SET_RELAY:a 182:DO_REPEAT_RELAY:a 183:DO_SET_SERVO:a 184:DO_REPEAT_SERVO:a
    187:DO_SET_ACTUATOR:p 189:DO_LAND_START:pa 195:DO_SET_ROI_LOCATION:pa 196:DO_SET_ROI_WPNEXT_OFFSET:p
    197:DO_SET_ROI_NONE:pa 200:DO_CONTROL_VIDEO:p 201:DO_SET_ROI:pa 202:DO_DIGICAM_CONFIGURE:a
    203:DO_DIGICAM_CONTROL:pa 204:DO_MOUNT_CONFIGURE:p 205:DO_MOUNT_CONTROL:pa 206:DO_SET_CAM_TRIGG_DIST:pa
    207:DO_FENCE_ENABLE:a 208:DO_PARACHUTE:a 211:DO_GRIPPER:pa 212:DO_AUTOTUNE_ENABLE:p
    214:DO_SET_CAM_TRIGG_INTERVAL:p 216:DO_SPRAYER:a 222:DO_GUIDED_LIMITS:a 260:OBLIQUE_SURVEY:p
    530:SET_CAMERA_MODE:pa 531:SET_CAMERA_ZOOM:pa 532:SET_CAMERA_FOCUS:pa 534:SET_CAMERA_SOURCE:p
    1000:DO_GIMBAL_MANAGER_PITCHYAW:pa 1001:DO_GIMBAL_MANAGER_CONFIGURE:p 2000:IMAGE_START_CAPTURE:pa
    2001:IMAGE_STOP_CAPTURE:pa 2003:DO_TRIGGER_CONTROL:p 2500:VIDEO_START_CAPTURE:pa 2501:VIDEO_STOP_CAPTURE:pa
    2502:VIDEO_START_STREAMING: 2503:VIDEO_STOP_STREAMING: 3000:DO_VTOL_TRANSITION:p 4501:CONDITION_GATE:p
    42600:DO_WINCH:pa
""")
# Messages of clients that one of both does not take, and what is special here, of those of vehicles too.
HEARD_BY_ONE = {"MISSION_WRITE_PARTIAL_LIST": "ardupilot", "REQUEST_DATA_STREAM": "ardupilot"}
HEARD_BY_NONE = {"MISSION_REQUEST_PARTIAL_LIST", "SET_ACTUATOR_CONTROL_TARGET"}
SPECIAL = {
    "FOLLOW_TARGET": "PX4's flavour",
    "REQUEST_DATA_STREAM": "ArduPilot's flavour",
    "CURRENT_MODE": "PX4's flavour",
    "EKF_STATUS_REPORT": "ArduPilot's flavour",
    "LOG_REQUEST_LIST": "an empty list",
    "FILE_TRANSFER_PROTOCOL": "refused",
    "MISSION_REQUEST_PARTIAL_LIST": "refused",
    "MISSION_WRITE_PARTIAL_LIST": "refused",
    "SET_ACTUATOR_CONTROL_TARGET": "refused by a STATUSTEXT",
}
# Messages of vehicles that one of both does not send; HIL_STATE_QUATERNION is that of PX4's own simulation.
SENT_BY_PX4 = {
    "ALTITUDE", "CURRENT_MODE", "ESTIMATOR_STATUS", "HIGHRES_IMU", "HIL_STATE_QUATERNION", "OBSTACLE_DISTANCE",
    "ODOMETRY", "OPTICAL_FLOW_RAD", "ORBIT_EXECUTION_STATUS", "PROTOCOL_VERSION", "WIND_COV",
}  # fmt: skip
SENT_BY_ARDUPILOT = {"EKF_STATUS_REPORT", "FENCE_STATUS"}
# What ArduPilot calls a parameter that does about the same.
COUNTERPARTS = {
    "COM_DISARM_LAND": "DISARM_DELAY", "COM_DISARM_PRFLT": "DISARM_DELAY", "COM_DL_LOSS_T": "FS_GCS_TIMEOUT",
    "COM_LOW_BAT_ACT": "BATT_FS_LOW_ACT", "COM_OF_LOSS_T": "GUID_TIMEOUT", "COM_RC_LOSS_T": "RC_OVERRIDE_TIME",
    "FLW_TGT_DST": "FOLL_OFS_X", "GF_ACTION": "FENCE_ACTION", "GF_MAX_HOR_DIST": "FENCE_RADIUS",
    "GF_MAX_VER_DIST": "FENCE_ALT_MAX", "GUID_OPTIONS": "GUID_OPTIONS", "MAV_SYS_ID": "SYSID_THISMAV",
    "MPC_ACC_HOR": "WPNAV_ACCEL",
    "MPC_JERK_AUTO": "WPNAV_JERK", "MPC_LAND_SPEED": "LAND_SPEED", "MPC_MAN_TILT_MAX": "ANGLE_MAX",
    "MPC_MAN_Y_MAX": "PILOT_Y_RATE", "MPC_THR_HOVER": "MOT_THST_HOVER", "MPC_VEL_MANUAL": "LOIT_SPEED",
    "MPC_XY_CRUISE": "WPNAV_SPEED", "MPC_YAW_MODE": "WP_YAW_BEHAVIOR", "MPC_Z_VEL_MAX_DN": "WPNAV_SPEED_DN",
    "MPC_Z_VEL_MAX_UP": "WPNAV_SPEED_UP", "NAV_ACC_RAD": "WPNAV_RADIUS", "NAV_DLL_ACT": "FS_GCS_ENABLE",
    "NAV_LOITER_RAD": "WP_LOITER_RAD", "NAV_RCL_ACT": "FS_THR_ENABLE", "RTL_DESCEND_ALT": "RTL_ALT_FINAL",
    "RTL_LAND_DELAY": "RTL_LOIT_TIME", "RTL_RETURN_ALT": "RTL_ALT",
}  # fmt: skip


def _row(*cells: object) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def _table(*header: str) -> list[str]:
    return ["", _row(*header), f"|{'---|' * len(header)}"]


def _yes(holds: bool) -> str:
    return "yes" if holds else NONE


def _takers(who: str) -> tuple[str, str]:
    return _yes("p" in who), _yes("a" in who)


def _here(taken: Sequence[bool]) -> str:
    """Return the table cell that names the flavours that take something."""
    return {(True, True): "yes", (True, False): "PX4's flavour", (False, True): "ArduPilot's flavour"}.get(
        (taken[0], taken[1]), NONE
    )


@cache
def _system(flavour: FlavourName) -> System:
    return System(FlightStack(Facts("a"), Site(), flavour=flavour), "a", 1)


def takes(flavour: FlavourName, number: int) -> bool:
    """Return whether a vehicle of a flavour answers a command with something else than UNSUPPORTED."""
    system = _system(flavour)
    link = Link(1, Streams(GROUND, 0.02), lambda data: None)
    command = Command(number, (1.0,) * 7)
    answer = requests.answer(system, link, command)
    return (system.stack.command(command) if answer is None else answer[0]).result is not Result.UNSUPPORTED


def _commands() -> Iterator[str]:
    yield from _table("command", "", "PX4", "ArduPilot", "here")
    for number, (name, who) in COMMANDS.items():
        yield _row(number, f"`{name}`", *_takers(who), _here([takes(one, number) for one in BOTH]))


def _items() -> Iterator[str]:
    yield from _table("plan item", "", "PX4", "ArduPilot", "here")
    for number, (name, who) in ITEMS.items():
        item = Item(0, 6, number, (1.0, 1.0, 1.0, 0.0), 10, 10, 5.0)
        taken = [plan.check([item], one)[0] is not PlanResult.UNSUPPORTED for one in BOTH]
        cell = _here(taken)
        if cell != NONE and not plan.moves(number):
            cell = "reached at once" if cell == "yes" else f"reached at once, {cell}"
        yield _row(number, f"`{name}`", *_takers(who), cell)


def _messages() -> Iterator[str]:
    yield from _table("message of a client", "PX4", "ArduPilot", "here")
    for name in sorted(dialogue.HEARD):
        one = HEARD_BY_ONE.get(name)
        who = (_yes(name not in HEARD_BY_NONE and one in (None, flavour)) for flavour in BOTH)
        yield _row(f"`{name}`", *who, SPECIAL.get(name, "yes"))
    yield from _table("message of a vehicle", "PX4", "ArduPilot", "here")
    for name in sorted(["AVAILABLE_MODES", *(BY_NUMBER[number].name for number in ENCODERS)]):
        who = (_yes(name not in SENT_BY_ARDUPILOT), _yes(name not in SENT_BY_PX4))
        yield _row(f"`{name}`", *who, SPECIAL.get(name, "yes"))


def _modes() -> Iterator[str]:
    yield from _table("mode here", "PX4", "ArduPilot")
    px4, copter = (FLAVOURS[one] for one in BOTH)
    for mode in Mode:
        cells = []
        for flavour, guided in ((px4, False), (copter, mode is Mode.GUIDED)):
            there = guided or mode in flavour.modes
            number = (flavour.guided if guided else flavour.numbers[mode]) if there else None
            name = "" if number is None else flavour.names[number]
            shown = number if flavour is copter else None if number is None else f"{number >> 16 & 255}, {number >> 24}"
            cells.append(NONE if number is None else f"{name} ({shown})")
        yield _row(mode.value, *cells)


def _parameters() -> Iterator[str]:
    yield from _table("parameter", "ArduPilot", "here")
    for one in TABLE:
        counterpart = COUNTERPARTS.get(one.name)
        value = f"{one.default:g}{'' if one.unit in ('', '1') else f' {one.unit}'}"
        yield _row(f"`{one.name}`", f"`{counterpart}`" if counterpart else NONE, value)


def written() -> str:
    """Return the tables."""
    lines = [line for part in (_commands, _items, _messages, _modes, _parameters) for line in part()]
    return "\n".join([BEGIN, *lines, "", END])


def rewritten(text: str) -> str:
    """Return a page with the tables of now."""
    before, _, rest = text.partition(BEGIN)
    return before + written() + rest.partition(END)[2]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print whether the page has the tables of now, or write them; return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    text = PAGE.read_text(encoding="utf-8")
    if given == ["--write"]:
        PAGE.write_text(rewritten(text), encoding="utf-8")
        return 0
    same = rewritten(text) == text
    print(f"docs/reference/{PAGE.name} " + ("has the tables of now" if same else "differs: --write"))
    return int(not same)


if __name__ == "__main__":
    raise SystemExit(main())
