"""The pages of MAVLink messages and of MAVLink parameters."""

from __future__ import annotations

from collections.abc import Mapping

from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.dialogue import HEARD
from qrsim.links.mavlink.stack.parameters import INT32, READ_ONLY, TABLE, Parameter
from qrsim.links.mavlink.stack.sim_parameters import SIM_TABLE
from qrsim.links.mavlink.streams import EACH_FIX, GROUND, ONBOARD
from qrsim.links.mavlink.telemetry import ENCODERS
from tools.reference.tables import code, number, page, table

# What a message needs, or when it is sent, beyond a sensor of its name.
NOTES = {
    "ATTITUDE": "at most once a tick",
    "ORBIT_EXECUTION_STATUS": "in an orbit",
    "WIND_COV": "an estimator of wind",
    "EKF_STATUS_REPORT": "ArduPilot's flavour",
    "CURRENT_MODE": "PX4's flavour; at each change too",
    "OBSTACLE_DISTANCE": "a sensor `scan`",
    "OPTICAL_FLOW_RAD": "a sensor `optical_flow`",
    "ADSB_VEHICLE": "a sensor `neighbours`; one neighbour in turn",
    "BATTERY_STATUS": "a battery that drains",
    "SCALED_PRESSURE": "a barometer that measures pressure",
    "DISTANCE_SENSOR": "a sensor `rangefinder`",
    "HIL_STATE_QUATERNION": "the true state, with `--truth` only",
    "FENCE_STATUS": "at the start and the end of a breach too",
    "GPS_RAW_INT": "a GNSS receiver",
    "MISSION_REQUEST_PARTIAL_LIST": "refused",
    "MISSION_WRITE_PARTIAL_LIST": "refused",
    "FILE_TRANSFER_PROTOCOL": "refused",
    "LOG_REQUEST_LIST": "answered by an empty list",
    "SET_ACTUATOR_CONTROL_TARGET": "refused",
}


def pages() -> Mapping[str, str]:
    """Return both pages."""
    return {"mavlink_messages.md": _messages(), "mavlink_parameters.md": _parameters()}


def _messages() -> str:
    introduction = """This page lists the messages that [`qrsim mavlink`](../howto/qgroundcontrol.md) sends and takes.
        [Messages, commands and set-points](mavlink.md) explains their content, and
        [another page](mavlink_compared.md) compares them with PX4 and ArduPilot."""
    sent = [
        (code(name), str(layout.number), _rate(name, ONBOARD), _rate(name, GROUND), NOTES.get(name, ""))
        for name, layout in sorted(LAYOUTS.items())
        if layout.number in ENCODERS
    ]
    replies = [
        (code(name), str(layout.number))
        for name, layout in sorted(LAYOUTS.items())
        if layout.number not in ENCODERS and name not in HEARD
    ]
    taken = [(code(name), str(LAYOUTS[name].number), NOTES.get(name, "")) for name in sorted(HEARD)]
    return page(
        "MAVLink messages",
        introduction,
        "## Sent",
        """Rates are in Hz of simulated time, on the ports of programs (UDP 14540 and following) and of ground stations
(14550). Messages "on request" are sent after `REQUEST_MESSAGE` or `SET_MESSAGE_INTERVAL`. A message without its sensor
is not sent.""",
        table(("message", "number", "programs", "ground station", "needs"), sent),
        "## Sent as replies and events",
        "Uploads and downloads of plans use the messages `MISSION_...` of the next table in both directions.",
        table(("message", "number"), replies),
        "## Taken",
        "Other messages are ignored.",
        table(("message", "number", "note"), taken),
    )


def _rate(name: str, rates: Mapping[str, float]) -> str:
    if name not in rates:
        return "on request"
    return "each fix; 5 without" if rates[name] == EACH_FIX else number(rates[name])


def _parameters() -> str:
    introduction = """This page lists the parameters of each vehicle of [`qrsim mavlink`](../howto/qgroundcontrol.md). A
        value beyond the range becomes the nearest one in it."""
    head = ("name", "type", "default", "range", "unit", "meaning")
    ours, simulators = (
        table(head, [(code(each.name), *_values(each), _meaning(each)) for each in parameters])
        for parameters in (TABLE, SIM_TABLE)
    )
    return page(
        "Parameters of MAVLink vehicles",
        introduction,
        ours,
        "## ArduPilot's simulator",
        """With `--flavour ardupilot` each vehicle also has these parameters of ArduPilot's simulator. They set
[faults of the vehicle and the wind](../howto/inject_faults_by_mavlink.md#ardupilots-simulator).""",
        simulators,
    )


def _values(each: Parameter) -> tuple[str, str, str, str]:
    def text(value: float) -> str:
        return str(int(value)) if each.type == INT32 else number(float(value))

    kind = "INT32" if each.type == INT32 else "REAL32"
    return kind, text(each.default), f"{text(each.low)} to {text(each.high)}", "" if each.unit == "1" else each.unit


def _meaning(each: Parameter) -> str:
    return f"{each.doc}; read only" if each.name in READ_ONLY and "read only" not in each.doc else each.doc
