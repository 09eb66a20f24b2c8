"""Modes of the stack, and their numbers in PX4's and in ArduPilot's language."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from qrsim.links.mavlink.stack.contracts import FlavourName


class Mode(Enum):
    """What a vehicle does; MANUAL stands for all modes that need a remote control, which there is none of."""

    HOLD = "hold"
    TAKEOFF = "takeoff"
    MISSION = "mission"
    RTL = "return"
    LAND = "land"
    OFFBOARD = "offboard"
    GUIDED = "guided"
    MANUAL = "manual"


# PX4: main mode, and the sub mode of AUTO (4).
_PX4 = {
    Mode.TAKEOFF: (4, 2), Mode.HOLD: (4, 3), Mode.MISSION: (4, 4), Mode.RTL: (4, 5), Mode.LAND: (4, 6),
    Mode.OFFBOARD: (6, 0),
}  # fmt: skip
_PX4_OF = {numbers: mode for mode, numbers in _PX4.items()}
_PX4_MANUAL = frozenset((1, 2, 3, 5, 7, 8))
# ArduPilot Copter; GUIDED is where scripts take off and send set-points.
_ARDUPILOT = {
    Mode.MISSION: 3, Mode.GUIDED: 4, Mode.HOLD: 5, Mode.RTL: 6, Mode.LAND: 9, Mode.TAKEOFF: 4, Mode.OFFBOARD: 4,
}  # fmt: skip
_ARDUPILOT_OF = {3: Mode.MISSION, 4: Mode.GUIDED, 5: Mode.HOLD, 6: Mode.RTL, 9: Mode.LAND, 17: Mode.HOLD}
_ARDUPILOT_MANUAL = frozenset((0, 1, 2, 7, 13, 16))
ARMED_FLAG = 128


@dataclass(frozen=True)
class Flavour:
    """Whose language a stack speaks.

    Attributes:
        name: "px4" or "ardupilot".
        autopilot: MAV_AUTOPILOT.
        base_mode: MAV_MODE_FLAG without the armed one.
    """

    name: FlavourName
    autopilot: int
    base_mode: int

    def custom_mode(self, mode: Mode, guided: bool = False) -> int:
        """Return the custom_mode of HEARTBEAT; ``guided``: HOLD is that of ArduPilot's GUIDED."""
        if self.name == "ardupilot":
            return 4 if guided and mode is Mode.HOLD else _ARDUPILOT[mode]
        main, sub = _PX4[mode]
        return (main << 16) | (sub << 24)

    def mode_of(self, main: int, sub: int) -> Mode | None:
        """Return the mode of DO_SET_MODE's numbers (of ArduPilot: the first), None where there is none."""
        if self.name == "ardupilot":
            return Mode.MANUAL if main in _ARDUPILOT_MANUAL else _ARDUPILOT_OF.get(main)
        if main in _PX4_MANUAL:
            return Mode.MANUAL
        return _PX4_OF.get((main, sub if main == 4 else 0))

    def of_custom(self, custom_mode: int) -> Mode | None:
        """Return the mode of a custom_mode, None where there is none."""
        if self.name == "ardupilot":
            return self.mode_of(custom_mode, 0)
        return self.mode_of((custom_mode >> 16) & 255, (custom_mode >> 24) & 255)


FLAVOURS: dict[str, Flavour] = {
    "px4": Flavour("px4", 12, 1 + 4 + 8 + 16),
    "ardupilot": Flavour("ardupilot", 3, 1 + 8 + 16 + 64),
}
