"""Modes of the stack, and their numbers and names in PX4's and in ArduPilot's language."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from qrsim.links.mavlink.stack.codes import ARDUPILOT, PX4
from qrsim.links.mavlink.stack.contracts import FlavourName
from qrsim.links.mavlink.stack.statuses import ModeInfo


class Mode(Enum):
    """What a vehicle does; POSITION, ALTITUDE and STABILIZED are flown by sticks."""

    HOLD = "hold"
    TAKEOFF = "takeoff"
    MISSION = "mission"
    RTL = "return"
    LAND = "land"
    OFFBOARD = "offboard"
    GUIDED = "guided"
    NOGPS = "guided_nogps"
    ORBIT = "orbit"
    FOLLOW = "follow"
    POSITION = "position"
    ALTITUDE = "altitude"
    STABILIZED = "stabilized"

    # Members are looked up in sets at every tick, and the hash of an Enum's name takes longer than the rest of that.
    __hash__ = object.__hash__


BY_STICKS = frozenset((Mode.POSITION, Mode.ALTITUDE, Mode.STABILIZED))
BY_SETPOINTS = frozenset((Mode.OFFBOARD, Mode.NOGPS))
# Modes in which a vehicle that has landed is to fly again.
FLIES_AGAIN = BY_STICKS | BY_SETPOINTS | {Mode.TAKEOFF, Mode.MISSION, Mode.FOLLOW}
ARMED_FLAG = 128
# MAV_MODE_FLAG of a vehicle that is flown by sticks: custom, stabilised, manual input.
_STICKS_FLAGS = 1 | 16 | 64
# MAV_STANDARD_MODE, of PX4's modes alone: ArduPilot calls all of its own non-standard.
STANDARD = {
    Mode.POSITION: 1,
    Mode.ORBIT: 2,
    Mode.ALTITUDE: 4,
    Mode.RTL: 5,
    Mode.MISSION: 6,
    Mode.LAND: 7,
    Mode.TAKEOFF: 8,
}
# MAV_MODE_PROPERTY, and PX4's modes that have the first.
ADVANCED, NOT_SELECTABLE = 1, 2
_ADVANCED = frozenset((Mode.STABILIZED, Mode.OFFBOARD, Mode.FOLLOW, Mode.ORBIT))


def _px4(main: int, sub: int = 0) -> int:
    """Return PX4's custom_mode number, which packs a main mode and a sub-mode."""
    return (main << 16) | (sub << 24)


@dataclass(frozen=True)
class Flavour:
    """Whose language a stack speaks.

    Attributes:
        name: "px4" or "ardupilot".
        autopilot: MAV_AUTOPILOT.
        base_mode: MAV_MODE_FLAG without the armed one.
        modes: those that the vehicle has.
        numbers: custom_mode of each of them, of PX4 of all modes.
        names: of custom_modes, also of those that it does not have.
        aliases: further custom_modes that are taken for a mode.
        guided: custom_mode of ArduPilot's GUIDED; -1 of PX4.
    """

    name: FlavourName
    autopilot: int
    base_mode: int
    modes: frozenset[Mode]
    numbers: Mapping[Mode, int]
    names: Mapping[int, str]
    aliases: Mapping[int, Mode] = field(default_factory=dict)
    guided: int = -1

    def custom_mode(self, mode: Mode, guided: bool = False) -> int:
        """Return the custom_mode of a flight mode for HEARTBEAT; ``guided``: HOLD is reported as ArduPilot's GUIDED."""
        return self.guided if guided and mode is Mode.HOLD and self.guided >= 0 else self.numbers[mode]

    def flags(self, mode: Mode) -> int:
        """Return the base_mode flags of a flight mode for HEARTBEAT, without the armed flag."""
        return _STICKS_FLAGS if mode in BY_STICKS and self.name == "px4" else self.base_mode

    def custom_of(self, main: int, sub: int) -> int:
        """Return the custom_mode for the two mode parameters of DO_SET_MODE; ArduPilot uses only ``main``."""
        return main if self.name == "ardupilot" else _px4(main, sub)

    def mode_of(self, custom_mode: int) -> Mode | None:
        """Return the flight mode of a custom_mode number, None for an unknown one.

        As in PX4's Commander any sub mode of Position is Position, and that of AUTO without one is Mission; an orbit
        begins by its command alone.
        """
        if self.guided >= 0 and custom_mode == self.guided:
            return Mode.GUIDED
        if self.name == "px4" and (custom_mode >> 16) & 255 != 4:
            custom_mode &= 0xFF0000
        if custom_mode in self.aliases:
            return self.aliases[custom_mode]
        return next((mode for mode, number in self.numbers.items() if number == custom_mode), None)

    def info(self, mode: Mode, guided: bool = False) -> ModeInfo:
        """Return a flight mode's entry for AVAILABLE_MODES and CURRENT_MODE; ``guided``: HOLD is reported as GUIDED."""
        custom = self.custom_mode(mode, guided)
        if self.name == "ardupilot":
            return ModeInfo(custom, name=self.names[custom])
        standard = STANDARD.get(mode, 0)
        properties = ADVANCED * (mode in _ADVANCED) | NOT_SELECTABLE * (mode is Mode.ORBIT)
        # Standard modes have no name of their own.
        return ModeInfo(custom, standard, properties, "" if standard else self.names[custom])

    def infos(self) -> tuple[ModeInfo, ...]:
        """Return the entries of AVAILABLE_MODES for all flight modes of the vehicle type, sorted by custom_mode."""
        found = {info.custom_mode: info for info in map(self.info, self.modes)}
        if self.guided >= 0:
            found[self.guided] = ModeInfo(self.guided, name=self.names[self.guided])
            found |= {custom: ModeInfo(custom, name=self.names[custom]) for custom in self.aliases}
        return tuple(found[custom] for custom in sorted(found))

    def standard_mode(self, number: int) -> Mode | None:
        """Return the flight mode of a MAV_STANDARD_MODE number, None if clients cannot request it."""
        found = next((mode for mode, standard in STANDARD.items() if standard == number), None)
        return found if found in self.modes and found is not Mode.ORBIT else None

    def refusal(self, custom_mode: int, why: str) -> str:
        """Return the text that refuses a flight mode because of ``why``, in the words of PX4's Commander or ArduPilot's
        Copter."""
        name = self.names.get(custom_mode)
        if self.name == "px4":
            return f"Switching to mode '{name}' is currently not possible: {why}" if name else "Unsupported mode"
        return f"Mode change to {name} failed: {why}" if name else f"No such mode {custom_mode}"


_PX4_NUMBERS = {
    Mode.STABILIZED: _px4(7),
    Mode.ALTITUDE: _px4(2),
    Mode.POSITION: _px4(3),
    Mode.ORBIT: _px4(3, 1),
    Mode.TAKEOFF: _px4(4, 2),
    Mode.HOLD: _px4(4, 3),
    Mode.MISSION: _px4(4, 4),
    Mode.RTL: _px4(4, 5),
    Mode.LAND: _px4(4, 6),
    Mode.FOLLOW: _px4(4, 8),
    Mode.OFFBOARD: _px4(6),
}
_PX4_NAMES = {
    _px4(1): "Manual",
    _px4(2): "Altitude",
    _px4(3): "Position",
    _px4(3, 1): "Orbit",
    _px4(3, 2): "Position Slow",
    _px4(4, 2): "Takeoff",
    _px4(4, 3): "Hold",
    _px4(4, 4): "Mission",
    _px4(4, 5): "Return",
    _px4(4, 6): "Land",
    _px4(4, 8): "Follow Target",
    _px4(4, 9): "Precision Landing",
    _px4(4, 10): "VTOL Takeoff",
    _px4(5): "Acro",
    _px4(6): "Offboard",
    _px4(7): "Stabilized",
}
# A multicopter's Manual is its Stabilized; Mission stands for AUTO without a sub mode.
_PX4_ALIASES = {_px4(1): Mode.STABILIZED, _px4(4): Mode.MISSION}
_COPTER = dict(enumerate((
    "STABILIZE", "ACRO", "ALT_HOLD", "AUTO", "GUIDED", "LOITER", "RTL", "CIRCLE", "", "LAND", "", "DRIFT", "", "SPORT",
    "FLIP", "AUTOTUNE", "POSHOLD", "BRAKE", "THROW", "AVOID_ADSB", "GUIDED_NOGPS", "SMART_RTL", "FLOWHOLD", "FOLLOW",
    "ZIGZAG", "SYSTEMID", "AUTOROTATE", "AUTO_RTL", "TURTLE",
)))  # fmt: skip
# GUIDED is where scripts take off and send set-points.
_COPTER_NUMBERS = {
    Mode.STABILIZED: 0,
    Mode.ALTITUDE: 2,
    Mode.MISSION: 3,
    Mode.HOLD: 5,
    Mode.RTL: 6,
    Mode.ORBIT: 7,
    Mode.LAND: 9,
    Mode.POSITION: 16,
    Mode.TAKEOFF: 4,
    Mode.OFFBOARD: 4,
    Mode.NOGPS: 20,
}
_ROVER = {
    0: "MANUAL",
    1: "ACRO",
    3: "STEERING",
    4: "HOLD",
    5: "LOITER",
    6: "FOLLOW",
    7: "SIMPLE",
    8: "DOCK",
    9: "CIRCLE",
    10: "AUTO",
    11: "RTL",
    12: "SMART_RTL",
    15: "GUIDED",
}
_PLANE = {
    0: "MANUAL",
    1: "CIRCLE",
    2: "STABILIZE",
    3: "TRAINING",
    4: "ACRO",
    5: "FBWA",
    6: "FBWB",
    7: "CRUISE",
    8: "AUTOTUNE",
    10: "AUTO",
    11: "RTL",
    12: "LOITER",
    13: "TAKEOFF",
    15: "GUIDED",
    24: "THERMAL",
}


def _flavours(
    own: Mapping[Mode, int], names: Mapping[int, str], guided: int, aliases: Mapping[int, Mode] | None = None
) -> dict[str, Flavour]:
    """Return the "px4" and "ardupilot" flavours of a vehicle type; ``own``, ``names``, ``guided``: ArduPilot's numbers
    and names of modes."""
    modes = frozenset(own)
    return {
        "px4": Flavour(
            "px4",
            PX4,
            1 + 4 + 8 + 16,
            modes - {Mode.NOGPS} | {Mode.FOLLOW} if Mode.TAKEOFF in own else modes,
            _PX4_NUMBERS,
            _PX4_NAMES,
            _PX4_ALIASES,
        ),
        "ardupilot": Flavour("ardupilot", ARDUPILOT, 1 + 8 + 16 + 64, modes, own, names, aliases or {}, guided),
    }


FLAVOURS = _flavours(_COPTER_NUMBERS, _COPTER, 4, {17: Mode.HOLD})
ROVER_FLAVOURS = _flavours({Mode.HOLD: 4, Mode.MISSION: 10, Mode.RTL: 11, Mode.OFFBOARD: 15}, _ROVER, 15)
WING_FLAVOURS = _flavours({Mode.HOLD: 12, Mode.MISSION: 10, Mode.RTL: 11}, _PLANE, 15)
