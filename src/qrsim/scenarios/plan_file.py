"""Reads QGroundControl .plan files: home, waypoints with what is asked at them, fence, and what is not flown.

The format is that of QGroundControl's developer guide, "Plan File Format"; commands and frames are MAVLink's MAV_CMD
and MAV_FRAME. Altitudes are taken from an item's parameters and frame, as a vehicle takes them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from qrsim.errors import ScenarioError
from qrsim.scenarios.legs import LONGEST_HOLD
from qrsim.scenarios.plan import Home, Ignored, Plan, Waypoint
from qrsim.scenarios.plan_fence import PlannedFence
from qrsim.scenarios.plan_jumps import JUMP, SimpleItem, in_order
from qrsim.scenarios.plan_parts import (
    LARGEST_LENGTH,
    PlanFaultError,
    check_kind,
    degrees_of,
    number_of,
    of_kind,
    part_of,
    place_of,
    plan_content,
    section_of,
    shown,
    with_lines,
)

WAYPOINT, LOITER_FOREVER, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 17, 18, 19, 20, 21, 22
LOITER_TO_ALTITUDE, DELAY, YAW, SPEED = 31, 93, 115, 178
_YAW = "yaw {:g} deg"
# Commands that are flown, and what their first four parameters ask for; "" where nothing is defined.
FLOWN: dict[int, tuple[str, tuple[str, str, str, str]]] = {
    WAYPOINT: ("NAV_WAYPOINT", ("hold for {:g} s", "acceptance radius {:g} m", "pass at {:g} m", _YAW)),
    LOITER_FOREVER: ("NAV_LOITER_UNLIM", ("", "", "loiter radius {:g} m", _YAW)),
    LOITER_TURNS: ("NAV_LOITER_TURNS", ("{:g} turns", "", "loiter radius {:g} m", "")),
    LOITER_TIME: ("NAV_LOITER_TIME", ("loiter for {:g} s", "", "loiter radius {:g} m", "")),
    RETURN: ("NAV_RETURN_TO_LAUNCH", ("", "", "", "")),
    LAND: ("NAV_LAND", ("abort altitude {:g} m", "precision landing mode {:g}", "", _YAW)),
    TAKEOFF: ("NAV_TAKEOFF", ("pitch {:g} deg", "", "", _YAW)),
    LOITER_TO_ALTITUDE: ("NAV_LOITER_TO_ALT", ("", "loiter radius {:g} m", "", "")),
}
# Of these, what a mission flies: the number of a parameter, and the field of a waypoint that it becomes. Multicopters
# do not circle but stay where they loiter for a time or for ever, so that these radii are not flown.
_ASKED: dict[int, dict[int, str]] = {
    WAYPOINT: {0: "hold", 1: "accept_radius", 3: "yaw_deg"},
    LOITER_FOREVER: {3: "yaw_deg"},
    LOITER_TURNS: {0: "turns", 2: "radius"},
    LOITER_TIME: {0: "hold"},
    LAND: {3: "yaw_deg"},
    TAKEOFF: {3: "yaw_deg"},
}
# Commands that a mission carries out on its way, and a route does not.
ON_THE_WAY = {DELAY: "NAV_DELAY", YAW: "CONDITION_YAW", SPEED: "DO_CHANGE_SPEED"}
# Commands that change no path.
NOT_FLOWN = {
    112: "CONDITION_DELAY", 114: "CONDITION_DISTANCE",
    181: "DO_SET_RELAY", 182: "DO_REPEAT_RELAY", 183: "DO_SET_SERVO", 184: "DO_REPEAT_SERVO", 189: "DO_LAND_START",
    195: "DO_SET_ROI_LOCATION", 196: "DO_SET_ROI_WPNEXT_OFFSET", 197: "DO_SET_ROI_NONE", 200: "DO_CONTROL_VIDEO",
    201: "DO_SET_ROI", 202: "DO_DIGICAM_CONFIGURE", 203: "DO_DIGICAM_CONTROL", 204: "DO_MOUNT_CONFIGURE",
    205: "DO_MOUNT_CONTROL", 206: "DO_SET_CAM_TRIGG_DIST", 207: "DO_FENCE_ENABLE", 211: "DO_GRIPPER",
    214: "DO_SET_CAM_TRIGG_INTERVAL", 530: "SET_CAMERA_MODE", 531: "SET_CAMERA_ZOOM", 532: "SET_CAMERA_FOCUS",
    1000: "DO_GIMBAL_MANAGER_PITCHYAW", 2000: "IMAGE_START_CAPTURE", 2001: "IMAGE_STOP_CAPTURE",
    2003: "DO_TRIGGER_CONTROL", 2500: "VIDEO_START_CAPTURE", 2501: "VIDEO_STOP_CAPTURE",
}  # fmt: skip
# Names, for messages, of others that occur in plans.
_OTHERS = {
    82: "NAV_SPLINE_WAYPOINT",
    84: "NAV_VTOL_TAKEOFF",
    85: "NAV_VTOL_LAND",
    94: "NAV_PAYLOAD_PLACE",
    113: "CONDITION_CHANGE_ALT",
    176: "DO_SET_MODE",
    179: "DO_SET_HOME",
    208: "DO_PARACHUTE",
    3000: "DO_VTOL_TRANSITION",
}
_ABOVE_SEA, _ABOVE_HOME = (0, 5), (3, 6)
_FRAMES = {1: "LOCAL_NED", 2: "MISSION", 4: "LOCAL_ENU", 10: "GLOBAL_TERRAIN_ALT", 11: "GLOBAL_TERRAIN_ALT_INT"}
_LARGEST_PARAMETER, _LARGEST_SPEED = 1e9, 50.0
_FLYABLE = {
    "hold": (0.0, LONGEST_HOLD, "s"),
    "accept_radius": (0.0, 1000.0, "m"),
    "turns": (0.0, 10_000.0, "turns"),
    "radius": (-10e3, 10e3, "m"),
}


def read_plan(path: str | Path) -> Plan:
    """Read a .plan file, version 1 with a mission of version 2 and a fence of version 2.

    Jumps are followed; one for ever is followed once and then leads to ``again``. A take-off without a place is above
    the last waypoint, or above home; a return is a waypoint above home at the height of the last. Landings are
    waypoints at the height they have. What a mission does at its waypoints (speeds, holds, delays, headings, circles)
    is theirs; cameras and the like are in ``ignored``.

    Raises:
        UsageError: the file cannot be read or is no JSON.
        ScenarioError: it is no plan, of another version, or asks for what cannot be flown; every fault with its path.
    """
    source = str(path)
    content = plan_content(source)
    try:
        check_kind(content)
        mission = section_of(content, "mission", 2)
        home = Home(
            *place_of(part_of(mission, "plannedHomePosition", list, "mission"), "mission.plannedHomePosition", 3)
        )
        items = part_of(mission, "items", list, "mission")
    except PlanFaultError as fault:
        raise ScenarioError(source, [str(fault)]) from None
    route, fence = _Route(home), PlannedFence()
    route.add_all(items, "mission.items")
    route.fly()
    fence.add_all(content)
    if problems := [*dict.fromkeys(route.problems), *fence.problems]:
        raise ScenarioError(source, with_lines(source, problems))
    return Plan(
        home,
        tuple(route.waypoints),
        tuple(fence.polygons),
        tuple(fence.circles),
        (*dict.fromkeys(route.ignored), *fence.ignored),
        route.delay,
        route.again,
    )


class _Route:
    """The waypoints so far, and what was found wrong or is not flown."""

    def __init__(self, home: Home):
        self.home = home
        self.waypoints: list[Waypoint] = []
        self.ignored: list[Ignored] = []
        self.problems: list[str] = []
        self.items: list[SimpleItem] = []
        self.again: int | None = None
        self.number = 0
        self.ended_by = ""
        self.delay = 0.0
        self.speed: float | None = None
        self.yaw_deg: float | None = None

    def fly(self) -> None:
        """Add the waypoints of all items, in the order of flight."""
        try:
            flight = in_order(self.items)
        except PlanFaultError as fault:
            self.problems.append(str(fault))
            return
        first, more = flight.again, []
        for i, item in enumerate(flight.items):
            if i == first:
                self.again = len(self.waypoints)
            self._add_one(item)
        if flight.jump is None or first is None:
            return
        if self.again in (None, len(self.waypoints)):
            what = "jumps endlessly over items that are not flown; the plan ends there"
            self.again, more = None, [Ignored(flight.jump.number, "DO_JUMP", what)]
        else:
            # Delays between the jump and the next waypoint belong to the last one.
            for item in flight.items[first:]:
                if item.content.get("command") in FLOWN:
                    break
                self._add_one(item)
            more = [Ignored(flight.jump.number, "DO_JUMP", "", "repeated once, not endlessly")]
        never = f"never reached, because DO_JUMP (item {flight.jump.number}) repeats endlessly"
        for item in self.items:
            if item.number in flight.unreached:
                more.append(Ignored(item.number, _name_of(item.content.get("command")), never))
        self.ignored += more

    def _add_one(self, item: SimpleItem) -> None:
        self.number = item.number
        try:
            self._add(item.content, item.path)
        except PlanFaultError as fault:
            self.problems.append(str(fault))

    def add_all(self, items: list[Any], where: str, inside: bool = False) -> None:
        """Take mission items; those of a survey are ``inside`` another item."""
        for i, item in enumerate(items):
            path = f"{where}.{i}"
            try:
                kind = of_kind(item, dict, path).get("type")
                if kind == "ComplexItem" and not inside:
                    self._add_survey(item, path)
                elif kind == "SimpleItem":
                    self.items.append(SimpleItem(len(self.items) + 1, path, item))
                else:
                    supported = "'SimpleItem'" if inside else "'SimpleItem', 'ComplexItem'"
                    raise PlanFaultError(f"{path}.type: is {shown(kind)}; supported: {supported}")
            except PlanFaultError as fault:
                self.problems.append(str(fault))

    def _add_survey(self, item: Mapping[str, object], path: str) -> None:
        key = "TransectStyleComplexItem"
        if key not in item:
            raise PlanFaultError(
                f"{path}: a ComplexItem of type {shown(item.get('complexItemType'))} cannot be flown; "
                f"supported: those with {key}.Items, such as 'survey' and 'CorridorScan'"
            )
        inner = part_of(item, key, dict, path)
        if inner.get("version", 1) not in (1, 2):
            raise PlanFaultError(
                f"{path}.{key}.version: version {shown(inner['version'])} is not supported; supported: 1, 2"
            )
        self.add_all(part_of(inner, "Items", list, f"{path}.{key}"), f"{path}.{key}.Items", inside=True)

    def _add(self, item: Mapping[str, object], path: str) -> None:
        """Add a simple item: a waypoint, or something not flown."""
        command = part_of(item, "command", int, path)
        if command in NOT_FLOWN:
            self.ignored.append(Ignored(self.number, NOT_FLOWN[command], "not carried out"))
            return
        if command in ON_THE_WAY:
            what = self._carry_out(command, _params(item, path), path)
            self.ignored.append(Ignored(self.number, ON_THE_WAY[command], what, "not carried out"))
            return
        if command not in FLOWN:
            name = f" ({_OTHERS[command]})" if command in _OTHERS else ""
            names = {**{each: words for each, (words, _) in FLOWN.items()}, **ON_THE_WAY, JUMP: "DO_JUMP"}
            flown = ", ".join(f"{each} ({words})" for each, words in names.items())
            raise PlanFaultError(
                f"{path}.command: {command}{name} cannot be flown (item {self.number}); flown: {flown}"
            )
        name, _ = FLOWN[command]
        if self.ended_by:
            raise PlanFaultError(f"{path}: {name} is never reached, because {self.ended_by} before it ends the route")
        params = _params(item, path)
        where = self._over_home(path) if command == RETURN else self._target(item, command, params, path)
        asked = self._note_params(item, command, params, path)
        more: dict[str, Any] = {"yaw_deg": self.yaw_deg, "speed": self.speed, **asked}
        self.waypoints.append(Waypoint(*where, self.number, name, **more))
        self.yaw_deg = None
        if command in (RETURN, LOITER_FOREVER):
            self.ended_by = f"{name} (item {self.number})"

    def _over_home(self, path: str) -> tuple[float, float, float]:
        if not self.waypoints:
            raise PlanFaultError(f"{path}: NAV_RETURN_TO_LAUNCH has no waypoint before it, whose height it would keep")
        return self.home.latitude_deg, self.home.longitude_deg, self.waypoints[-1].height_above_home

    def _target(
        self, item: Mapping[str, object], command: int, params: Sequence[object], path: str
    ) -> tuple[float, float, float]:
        """Return latitude, longitude [deg] and height above home [m] of an item."""
        frame = part_of(item, "frame", int, path)
        if frame not in (*_ABOVE_SEA, *_ABOVE_HOME):
            name = f" ({_FRAMES[frame]})" if frame in _FRAMES else ""
            raise PlanFaultError(
                f"{path}.frame: {frame}{name} is not supported; "
                "supported: 0 and 5 (altitude above sea level), 3 and 6 (above home)"
            )
        places = [f"{path}.params.{i}" for i in (4, 5, 6)]
        altitude = number_of(params[6], f"{places[2]} (altitude)", LARGEST_LENGTH, "m")
        height = altitude - self.home.altitude_amsl if frame in _ABOVE_SEA else altitude
        # MAVLink has two ways to say 'where the vehicle is'.
        if (params[4] is None and params[5] is None) or (params[4] == 0.0 and params[5] == 0.0):
            if command != TAKEOFF:
                raise PlanFaultError(
                    f"{places[0]}: latitude and longitude are {shown(params[4])}, which stands for the current "
                    "place; only NAV_TAKEOFF may leave its place out"
                )
            here: Home | Waypoint = self.waypoints[-1] if self.waypoints else self.home
            return here.latitude_deg, here.longitude_deg, height
        where = (f"{places[0]} (latitude)", f"{places[1]} (longitude)")
        return (*degrees_of(params[4], params[5], where), height)

    def _note_params(
        self, item: Mapping[str, object], command: int, params: Sequence[object], path: str
    ) -> dict[str, float]:
        """Return what an item asks a mission for beside its place, and record what it does not fly.

        Null and 0 ask for nothing; but a heading of 0 is north.
        """
        name, words = FLOWN[command]
        asked, missed, flown = [], [], {}
        for i, (value, word) in enumerate(zip(params, words, strict=False)):
            field = _ASKED.get(command, {}).get(i)
            if value is None:
                continue
            number = number_of(value, f"{path}.params.{i}", _LARGEST_PARAMETER, "")
            if field and (number != 0.0 or field == "yaw_deg"):
                flown[field] = _asked_of(field, number, f"{path}.params.{i}")
            if number != 0.0:
                text = (word or f"parameter {i + 1} = {{:g}}").format(number)
                asked.append(text)
                missed += [] if field else [text]
        if item.get("autoContinue") is False:
            asked.append("stop after it (autoContinue is false)")
            missed.append(asked[-1])
        if asked:
            self.ignored.append(Ignored(self.number, name, _not_flown(missed), _not_flown(asked)))
        return flown

    def _carry_out(self, command: int, params: Sequence[object], path: str) -> str:
        """Do what an item asks of the way to come; return what of it is not flown, "" for nothing."""
        numbers = [
            None if value is None else number_of(value, f"{path}.params.{i}", _LARGEST_PARAMETER, "")
            for i, value in enumerate(params[:4])
        ]
        first, second, _, fourth = (number or 0.0 for number in numbers)
        if command == DELAY:
            return self._wait(first)
        if command == YAW:
            if fourth != 0.0:
                return "a heading relative to the present one is not carried out"
            self.yaw_deg = _asked_of("yaw_deg", first, f"{path}.params.0")
            return ""
        if first not in (0.0, 1.0):
            return "speeds of climb and descent are not carried out"
        # MAVLink: -1 is no change, -2 the default.
        if second == -2.0:
            self.speed = None
        elif second > _LARGEST_SPEED:
            allowed = f"at most {_LARGEST_SPEED:g} m/s, -1 (no change) and -2 (default)"
            raise PlanFaultError(f"{path}.params.1 (speed): {second:g} is out of range; allowed: {allowed}")
        elif second > 0.0:
            self.speed = second
        elif second != -1.0:
            return f"a speed of {second:g} m/s is not carried out"
        return ""

    def _wait(self, seconds: float) -> str:
        if seconds < 0.0:
            return "a delay until a time of day is not carried out"
        if not self.waypoints:
            self.delay += seconds
        else:
            last = self.waypoints[-1]
            self.waypoints[-1] = replace(last, hold=last.hold + seconds)
        return ""


def _not_flown(asked: list[str]) -> str:
    return f"not flown: {', '.join(asked)}" if asked else ""


def _name_of(command: object) -> str:
    """Return the name of a command for messages."""
    names = {**{each: words for each, (words, _) in FLOWN.items()}, **ON_THE_WAY, **NOT_FLOWN, **_OTHERS}
    return names.get(command, str(command)) if isinstance(command, int) else "?"


def _params(item: Mapping[str, object], path: str) -> list[object]:
    params: list[object] = part_of(item, "params", list, path)
    if len(params) != 7:
        raise PlanFaultError(f"{path}.params: expected 7 values, found {len(params)}")
    return params


def _asked_of(field: str, number: float, where: str) -> float:
    """Return a number that a mission is asked for, within what it can fly."""
    if field == "yaw_deg":
        return math.remainder(number, 360.0)
    low, high, unit = _FLYABLE[field]
    if not low <= number <= high:
        raise PlanFaultError(f"{where}: {number:g} is out of range; allowed: {low:g} to {high:g} {unit}")
    return number
