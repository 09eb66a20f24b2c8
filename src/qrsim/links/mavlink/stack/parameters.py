"""Parameters of the flight stack: typed, with limits, by the names and defaults of PX4's."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

# MAV_PARAM_TYPE.
INT32, REAL32 = 6, 9


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    Attributes:
        name: at most 16 characters.
        type: INT32 or REAL32.
        default, low, high: its value at boot, and its range; a value beyond it becomes the nearest one in it.
        unit: of it.
        doc: what it does.
    """

    name: str
    type: int
    default: float
    low: float
    high: float
    unit: str
    doc: str


class Outcome(Enum):
    """What became of a value that was set."""

    SET = "set"
    CLAMPED = "clamped"
    UNKNOWN = "unknown"
    WRONG_TYPE = "wrong_type"
    READ_ONLY = "read_only"
    NOT_FINITE = "not_finite"
    REFUSED = "refused"


def _real(name: str, default: float, low: float, high: float, unit: str, doc: str) -> Parameter:
    """Return the definition of a float parameter: default, lowest and highest value, unit, description."""
    return Parameter(name, REAL32, default, low, high, unit, doc)


def _int(name: str, default: int, low: int, high: int, doc: str) -> Parameter:
    """Return the definition of an integer parameter: default, lowest and highest value, description."""
    return Parameter(name, INT32, default, low, high, "", doc)


# In the order of their names, as PX4 lists them.
TABLE: tuple[Parameter, ...] = (
    _real("BAT_CRIT_THR", 0.07, 0.05, 0.5, "1", "charge at which a battery is critical, and arming refused"),
    _real("BAT_EMERGEN_THR", 0.05, 0.03, 0.5, "1", "charge at which a battery is an emergency"),
    _real("BAT_LOW_THR", 0.15, 0.12, 0.5, "1", "charge at which a battery is low"),
    _int("CAL_ACC0_ID", 196616, 0, 9999999, "kept for clients that read it: a calibrated accelerometer"),
    _int("CAL_GYRO0_ID", 196616, 0, 9999999, "kept for clients that read it: a calibrated gyroscope"),
    _int("CAL_MAG0_ID", 197388, 0, 9999999, "kept for clients that read it: a calibrated magnetometer"),
    _real("COM_DISARM_LAND", 2.0, -1.0, 20.0, "s", "time on the ground after a landing until disarmed; below 0: never"),
    _real("COM_DISARM_PRFLT", 10.0, -1.0, 600.0, "s", "time armed without a take-off until disarmed; below 0: never"),
    _int("COM_DL_LOSS_T", 10, 5, 300, "seconds without a heartbeat of a ground station until the link is lost"),
    _int("COM_LOW_BAT_ACT", 0, 0, 3, "0 warn; 2 land at critical; 3 return at critical, land at emergency"),
    _int("COM_OBL_RC_ACT", 0, 0, 7, "offboard lost: 0 to 2 and 5 hold, 3 return, 4 land, 6 terminate, 7 disarm"),
    _real("COM_OF_LOSS_T", 1.0, 0.0, 60.0, "s", "time without a set-point until offboard is lost"),
    _int("COM_RC_IN_MODE", 1, 0, 4, "sticks: 0 RC override; 1 MANUAL_CONTROL; 2, 3 both; 4 none; PX4 only"),
    _real("COM_RC_LOSS_T", 0.5, 0.0, 35.0, "s", "time without sticks until they are lost; PX4 only"),
    _int("COM_RC_OVERRIDE", 1, 0, 3, "1, 3: sticks that move far take over from automatic modes; PX4 only"),
    _int("FLW_TGT_ALT_M", 0, 0, 2, "follow-me: 0 and 1 height over home, 2 over the target"),
    _real("FLW_TGT_DST", 8.0, 1.0, 1000.0, "m", "follow-me: distance to the target"),
    _real("FLW_TGT_FA", 180.0, -180.0, 180.0, "deg", "follow-me: side of the target; 0 in front, 90 to its right"),
    _real("FLW_TGT_HT", 8.0, 8.0, 1000.0, "m", "follow-me: height"),
    _real("FLW_TGT_MAX_VEL", 5.0, 0.0, 20.0, "m/s", "follow-me: largest speed around the target"),
    _real("FLW_TGT_RS", 0.1, 0.0, 1.0, "1", "kept for clients that set it: the target is taken as reported"),
    _int("GF_ACTION", 2, 0, 5, "fence breached: 0 none, 1 warn, 2 hold, 3 return, 4 terminate, 5 land"),
    _real("GF_MAX_HOR_DIST", 0.0, 0.0, 10000.0, "m", "largest distance from home; 0: any"),
    _real("GF_MAX_VER_DIST", 0.0, 0.0, 10000.0, "m", "largest height over home; 0: any"),
    _int("GUID_OPTIONS", 0, 0, 511, "8: in GUIDED the thrust of attitudes is a thrust, else a climb; ArduPilot only"),
    _int("MAV_COMP_ID", 1, 1, 250, "component id; read only"),
    _int("MAV_SYS_ID", 1, 1, 250, "system id; read only"),
    _real("MIS_TAKEOFF_ALT", 2.5, 0.0, 80.0, "m", "height of a take-off without one"),
    _real("MPC_ACC_HOR", 3.0, 2.0, 15.0, "m/s^2", "largest horizontal acceleration of the path"),
    _real("MPC_JERK_AUTO", 4.0, 1.0, 80.0, "m/s^3", "largest jerk of the path"),
    _real("MPC_LAND_SPEED", 0.7, 0.3, 1.4, "m/s", "speed of a landing near the ground"),
    _real("MPC_MAN_TILT_MAX", 35.0, 1.0, 70.0, "deg", "largest tilt by sticks"),
    _real("MPC_MAN_Y_MAX", 150.0, 0.0, 400.0, "deg/s", "largest turn by the yaw stick"),
    _real("MPC_THR_HOVER", 0.5, 0.1, 0.8, "1", "thrust of set-points that carries the weight"),
    _real("MPC_TKO_SPEED", 1.5, 0.5, 5.0, "m/s", "speed of a take-off"),
    _real("MPC_VEL_MANUAL", 10.0, 3.0, 20.0, "m/s", "largest horizontal speed by sticks"),
    _real("MPC_XY_CRUISE", 5.0, 3.0, 20.0, "m/s", "speed of missions, return and reposition"),
    _real("MPC_XY_VEL_MAX", 12.0, 0.0, 20.0, "m/s", "largest horizontal speed of set-points"),
    _int("MPC_YAW_MODE", 0, 0, 4, "heading on the way: 0 to the place, 1 to home, 2 from home, 3 along, 4 turn first"),
    _real("MPC_Z_VEL_MAX_DN", 1.5, 0.5, 4.0, "m/s", "largest speed downwards"),
    _real("MPC_Z_VEL_MAX_UP", 3.0, 0.5, 8.0, "m/s", "largest speed upwards"),
    _real("NAV_ACC_RAD", 2.0, 0.05, 200.0, "m", "distance at which an item without one counts as reached"),
    _int("NAV_DLL_ACT", 0, 0, 6, "link to the ground lost: 0 none, 1 hold, 2 return, 3 land, 5 terminate, 6 disarm"),
    _real("NAV_LOITER_RAD", 80.0, 25.0, 1000.0, "m", "radius of circles of a fixed wing; default: its controller's"),
    _int("NAV_RCL_ACT", 2, 0, 6, "sticks lost in a mode that needs them: as NAV_DLL_ACT"),
    _real("RTL_DESCEND_ALT", 10.0, 0.0, 100.0, "m", "height over home from which a return lands slowly"),
    _real("RTL_LAND_DELAY", 0.0, -1.0, 100.0, "s", "time above home before a return lands; below 0: it does not"),
    _real("RTL_MIN_DIST", 10.0, 0.5, 100.0, "m", "distance from home within which a return climbs less"),
    _real("RTL_RETURN_ALT", 60.0, 0.0, 150.0, "m", "height over home of a return"),
    _int("SYS_AUTOCONFIG", 0, 0, 2, "kept for clients that read it"),
    _int("SYS_AUTOSTART", 4001, 0, 9999999, "kept for clients that read it: a quadrotor x"),
    _int("SYS_FAILURE_EN", 0, 0, 1, "1: clients may inject failures (MAV_CMD_INJECT_FAILURE)"),
    _int("SYS_HITL", 0, 0, 2, "kept for clients that read it: no hardware in the loop"),
)
READ_ONLY = frozenset({"MAV_SYS_ID", "MAV_COMP_ID"})


class Parameters:
    """Values of the table of one vehicle.

    Args:
        start: values that differ from the defaults, by name.
        table: of all parameters, in their order.

    Raises:
        KeyError: there is no such parameter.

    Attributes:
        changed: called with the name of a parameter of a simulator, SIM_..., that has a new value; returns whether that
            can be, else it is the one of before.
    """

    def __init__(self, start: Mapping[str, float] | None = None, table: Sequence[Parameter] = TABLE):
        self.changed: Callable[[str], bool] | None = None
        self._rows = table
        self._table = {parameter.name: parameter for parameter in table}
        self._index = {name: number for number, name in enumerate(self._table)}
        self.values = {name: parameter.default for name, parameter in self._table.items()}
        for name, value in (start or {}).items():
            self.values[name] = _within(self._table[name], value)

    def __len__(self) -> int:
        return len(self.values)

    def __iter__(self) -> Iterator[Parameter]:
        """Return all parameters in their order."""
        return iter(self._table.values())

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def __getitem__(self, name: str) -> float:
        """Return the value of a parameter; raises KeyError."""
        return self.values[name]

    def at(self, index: int) -> Parameter | None:
        """Return the definition of the parameter at an index of the parameter list; None if out of range."""
        return self._rows[index] if 0 <= index < len(self._rows) else None

    def index(self, name: str) -> int:
        """Return a parameter's index in the parameter list; raises KeyError for an unknown name."""
        return self._index[name]

    def parameter(self, name: str) -> Parameter | None:
        """Return the definition of a parameter by name, None if it is unknown."""
        return self._table.get(name)

    def set(self, name: str, value: float, type: int | None = None) -> Outcome:
        """Set a parameter of a client's MAV_PARAM_TYPE ``type``, clipped to its range; return set, clamped, or why it
        is refused.

        Args:
            name: of it.
            value: as a number, of an INT32 as an integer and not as its bytes.
            type: MAV_PARAM_TYPE that the client says it is; None: it does not.
        """
        known = self._table.get(name)
        if known is None:
            return Outcome.UNKNOWN
        if type is not None and type != known.type:
            return Outcome.WRONG_TYPE
        if not math.isfinite(value):
            return Outcome.NOT_FINITE
        if name in READ_ONLY:
            return Outcome.READ_ONLY
        before, self.values[name] = self.values[name], _within(known, value)
        if name.startswith("SIM_") and self.changed is not None and not self.changed(name):
            self.values[name] = before
            return Outcome.REFUSED
        return Outcome.SET if known.low <= value <= known.high else Outcome.CLAMPED


def _within(known: Parameter, value: float) -> float:
    """Return a value clipped to a parameter's range, and rounded if the parameter is an integer."""
    clamped = min(max(value, known.low), known.high)
    return float(round(clamped)) if known.type == INT32 else clamped
