"""From mission items in the order of the file to waypoints in the order of flight, with what is asked at them.

Altitudes are taken from an item's parameters and frame, as a vehicle takes them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from qrsim.files import Content
from qrsim.scenarios.legs import LONGEST_HOLD
from qrsim.scenarios.plans import commands as known
from qrsim.scenarios.plans.jumps import SimpleItem, in_order
from qrsim.scenarios.plans.parts import LARGEST_LENGTH, PlanFaultError, degrees_of, number_of, part_of
from qrsim.scenarios.plans.plan import Above, Condition, Home, Ignored, RallyPoint, Waypoint

LARGEST_PARAMETER, LARGEST_SPEED = 1e9, 50.0
# Height of a take-off without an altitude [m]: PX4's MIS_TAKEOFF_ALT.
TAKE_OFF_HEIGHT = 2.5
_FLYABLE = {
    "hold": (0.0, LONGEST_HOLD, "s"),
    "accept_radius": (0.0, 1000.0, "m"),
    "turns": (0.0, 10_000.0, "turns"),
    "radius": (-10e3, 10e3, "m"),
}
_SPEEDS = {0.0: "speed", 1.0: "speed", 2.0: "climb", 3.0: "sink"}


class Route:
    """The waypoints so far, and what was found wrong or is not flown.

    Args:
        home: of the plan.
        rally: places that a return may lead to, the nearest of them and home.

    Attributes:
        waypoints, ignored, delay, again: as those of a ``Plan``.
        problems: paths of values, and what is wrong with them.
        items: as the file has them.
    """

    def __init__(self, home: Home, rally: Sequence[RallyPoint] = ()):
        self.home = home
        self.rally = rally
        self.waypoints: list[Waypoint] = []
        self.ignored: list[Ignored] = []
        self.problems: list[str] = []
        self.items: list[SimpleItem] = []
        self.again: int | None = None
        self.delay = 0.0
        self._item: SimpleItem
        self._ended_by = ""
        self._asked: dict[str, float | None] = {"speed": None, "climb": None, "sink": None}
        self._heading: dict[str, float] = {}
        self._until: Condition | None = None

    def take(self, content: Mapping[str, object], path: str, side_deg: float | None = None) -> None:
        """Append the file's next mission item, with a heading relative to its course (``side_deg``); see ``fly``."""
        self.items.append(SimpleItem(len(self.items) + 1, path, dict(content), side_deg))

    def fly(self) -> None:
        """Convert all mission items to waypoints, in the order of flight."""
        try:
            flight = in_order(self.items)
        except PlanFaultError as fault:
            self.problems.append(str(fault))
            return
        first = flight.again
        for i, item in enumerate(flight.items):
            if i == first:
                self.again = len(self.waypoints)
            self._add_one(item)
        if flight.jump is None or first is None:
            return
        # Delays between the jump and the next waypoint belong to the last one.
        for item in flight.items[first:]:
            if item.flies:
                break
            self._add_one(item)
        self.ignored.append(Ignored(flight.jump.number, "DO_JUMP", "", "repeated once, not endlessly"))

    def _add_one(self, item: SimpleItem) -> None:
        """Convert one mission item; an error in it becomes a problem of the plan."""
        self._item = item
        try:
            self._add(item.content, item.path)
        except PlanFaultError as fault:
            self.problems.append(str(fault))

    def _add(self, item: Mapping[str, object], path: str) -> None:
        """Convert a simple mission item: to a waypoint, to an order for the next ones, or to a note of
        an ignored item."""
        number, command = self._item.number, part_of(item, "command", int, path)
        row = known.COMMANDS.get(command)
        if row is None or row.kind == "refused":
            raise PlanFaultError(f"{path}.command: {_why_refused(command, number)}")
        if row.kind == "skipped":
            if command == known.FENCE_ENABLE and params_of(item, path)[0] == 0:
                raise PlanFaultError(f"{path}.params.0: DO_FENCE_ENABLE turns the fence off; {known.FENCE_OFF}")
            self.ignored.append(Ignored(number, row.name, "not carried out"))
            return
        params = params_of(item, path)
        if row.kind == "order" and command != known.RETURN:
            what = self._carry_out(command, params, path)
            self.ignored.append(Ignored(number, row.name, what, "not carried out"))
            return
        if self._ended_by:
            raise PlanFaultError(
                f"{path}: {row.name} is never reached, because {self._ended_by} before it ends the route"
            )
        where = self._way_back(path) if command == known.RETURN else self._target(item, command, params, path)
        asked = self._note_params(item, row, params, path)
        more: Content = {**self._asked, **self._heading, **asked}
        side = self._item.side_deg if len(self.waypoints) else None
        self.waypoints.append(
            Waypoint(**where, item=number, command=row.name, side_deg=side, until=self._until, path=path, **more)
        )
        self._heading, self._until = {}, None
        if command in (known.RETURN, known.LOITER_FOREVER):
            self._ended_by = f"{row.name} (item {number})"

    # ---- places ----

    def _way_back(self, path: str) -> Content:
        """Return place and height of the return command as waypoint fields: home, or the nearest rally point."""
        if not self.waypoints:
            raise PlanFaultError(f"{path}: NAV_RETURN_TO_LAUNCH has no waypoint before it to take a height from")
        last = self.waypoints[-1]
        places: list[Home | RallyPoint] = [self.home, *self.rally]
        nearest = min(places, key=lambda place: _apart(place, last))
        found = _at(nearest.latitude_deg, nearest.longitude_deg, last.altitude, last.above, last.height_above_home)
        # A rally point is as high as it says; a return lands below it.
        if isinstance(nearest, RallyPoint) and nearest.height_above_home > last.height_above_home:
            height = nearest.height_above_home
            found = _at(nearest.latitude_deg, nearest.longitude_deg, height, "home", height) | {"climbs": True}
        return found

    def _target(self, item: Mapping[str, object], command: int, params: Sequence[object], path: str) -> Content:
        """Return place and height of a mission item as waypoint fields; ``path`` is its place in the file."""
        last = self.waypoints[-1] if self.waypoints else None
        places = [f"{path}.params.{i}" for i in (4, 5, 6)]
        placeless = _is_placeless(params)
        above = self._datum(item, path, placeless)
        if params[6] is None:
            altitude, above, height = self._height_before(command, last, places[2])
        else:
            altitude = number_of(params[6], f"{places[2]} (altitude)", LARGEST_LENGTH, "m")
            height = altitude - self.home.altitude_amsl if above == "sea" else altitude
        if placeless:
            here: Home | Waypoint = last or self.home
            return _at(here.latitude_deg, here.longitude_deg, altitude, above, height)
        where = (f"{places[0]} (latitude)", f"{places[1]} (longitude)")
        return _at(*degrees_of(params[4], params[5], where), altitude, above, height)

    def _datum(self, item: Mapping[str, object], path: str, placeless: bool) -> Above:
        """Return the reference of an item's altitude, "home", "ground" or "sea"; ``placeless``: it has no position."""
        frame = part_of(item, "frame", int, path)
        if frame in known.ABOVE_SEA:
            return "sea"
        if frame in known.ABOVE_HOME or (placeless and frame == known.MISSION_FRAME):
            return "home"
        if frame in known.ABOVE_GROUND:
            return "ground"
        name = f" ({known.OTHER_FRAMES[frame]})" if frame in known.OTHER_FRAMES else ""
        raise PlanFaultError(
            f"{path}.frame: {frame}{name} is not supported; supported: 0, 3, 5, 6, 10, 11, and 2 where an item has "
            "no place"
        )

    @staticmethod
    def _height_before(command: int, last: Waypoint | None, where: str) -> tuple[float, Above, float]:
        """Return (altitude [m], its reference, height above home [m]) for an item that gives no altitude."""
        if command == known.TAKEOFF and (last is None or last.command == "NAV_LAND"):
            return TAKE_OFF_HEIGHT, "home", TAKE_OFF_HEIGHT
        if last is not None:
            return last.altitude, last.above, last.height_above_home
        if command == known.LAND:
            return 0.0, "home", 0.0
        raise PlanFaultError(f"{where} (altitude): is null, which means 'as before', but no place is before it")

    # ---- what is asked ----

    def _note_params(
        self, item: Mapping[str, object], row: known.Command, params: Sequence[object], path: str
    ) -> dict[str, float]:
        """Return the waypoint fields that an item's parameters set; note those parameters that are not flown.

        Null and 0 ask for nothing; but a heading of 0 is north.
        """
        asked, missed, flown = [], [], {}
        for i, (value, word) in enumerate(zip(params, row.words, strict=False)):
            name = row.asked.get(i)
            if value is None:
                continue
            number = number_of(value, f"{path}.params.{i}", LARGEST_PARAMETER, "")
            if name and (number != 0.0 or name == "yaw_deg"):
                flown[name] = checked_param(name, number, f"{path}.params.{i}")
            if number != 0.0:
                text = (word or f"parameter {i + 1} = {{:g}}").format(number)
                asked.append(text)
                missed += [] if name else [text]
        if item.get("autoContinue") is False:
            asked.append("stop after it (autoContinue is false)")
            missed.append(asked[-1])
        if asked:
            self.ignored.append(Ignored(self._item.number, row.name, _not_flown(missed), _not_flown(asked)))
        return flown

    def _carry_out(self, command: int, params: Sequence[object], path: str) -> str:
        """Apply a command without waypoint (delay, yaw, home, speed, condition); return a note on parts not flown."""
        numbers = [
            None if value is None else number_of(value, f"{path}.params.{i}", LARGEST_PARAMETER, "")
            for i, value in enumerate(params[:4])
        ]
        first, second, third, fourth = (number or 0.0 for number in numbers)
        if command in (known.DELAY, known.CONDITION_DELAY):
            return self._wait(first, path)
        if command == known.CONDITION_YAW:
            if fourth > 0.0:
                self._heading = {"turn_deg": -first if third < 0.0 else first}
            else:
                self._heading = {"yaw_deg": checked_param("yaw_deg", first, f"{path}.params.0")}
            return ""
        if command == known.SET_HOME:
            self._set_home(first, params, path)
            return ""
        if command in (known.CONDITION_DISTANCE, known.GATE):
            return self._await(command, first, params, path)
        return self._change_speed(first, second, path)

    def _change_speed(self, kind: float, speed: float, path: str) -> str:
        """Apply DO_CHANGE_SPEED to the next waypoints; return a note on parts that are not flown, or ""."""
        if kind not in _SPEEDS:
            raise PlanFaultError(f"{path}.params.0: {kind:g} is no kind of speed; allowed: 0 to 3")
        name = _SPEEDS[kind]
        # MAVLink: -1 is no change, -2 the default.
        if speed == -2.0:
            self._asked[name] = None
        elif speed > LARGEST_SPEED:
            allowed = f"at most {LARGEST_SPEED:g} m/s, -1 (no change) and -2 (default)"
            raise PlanFaultError(f"{path}.params.1 (speed): {speed:g} is out of range; allowed: {allowed}")
        elif speed > 0.0:
            self._asked[name] = speed
        elif speed != -1.0:
            return f"a speed of {speed:g} m/s is not carried out"
        return ""

    def _await(self, command: int, distance: float, params: Sequence[object], path: str) -> str:
        """Keep the present speed and heading until the vehicle meets a condition on the way to the next waypoint."""
        gate = None
        if command == known.GATE:
            where = (f"{path}.params.4 (latitude)", f"{path}.params.5 (longitude)")
            gate = degrees_of(params[4], params[5], where)
        elif distance < 0.0:
            raise PlanFaultError(f"{path}.params.0: {distance:g} is out of range; allowed: 0 or more m")
        yaw = self._heading.get("yaw_deg")
        self._until = Condition(None if gate else distance, gate, **self._asked, yaw_deg=yaw)
        return ""

    def _set_home(self, here: float, params: Sequence[object], path: str) -> None:
        """Handle DO_SET_HOME: ``here`` 1: the last waypoint, else ``params``; altitudes count from the first home."""
        if here >= 0.5 or _is_placeless(params):
            place: Home | Waypoint = self.waypoints[-1] if self.waypoints else self.home
            found = place.latitude_deg, place.longitude_deg
        else:
            found = degrees_of(params[4], params[5], (f"{path}.params.4 (latitude)", f"{path}.params.5 (longitude)"))
        self.home = Home(*found, self.home.altitude_amsl)

    def _wait(self, seconds: float, path: str) -> str:
        """Add a delay [s] to the last waypoint, or to the start; return a note on parts that are not flown, or ""."""
        if seconds < 0.0:
            return "a delay until a time of day is not carried out"
        last = self.waypoints[-1] if self.waypoints else None
        whole = seconds + (last.hold if last else self.delay)
        if whole > LONGEST_HOLD:
            raise PlanFaultError(
                f"{path}.params.0: {whole:g} s in all are out of range; allowed: 0 to {LONGEST_HOLD:g} s"
            )
        if last is None:
            self.delay = whole
        else:
            self.waypoints[-1] = replace(last, hold=whole)
        return ""


def params_of(item: Mapping[str, object], path: str) -> list[object]:
    """Return the seven parameters of a mission item; raises PlanFaultError for another number of them."""
    params: list[object] = part_of(item, "params", list, path)
    if len(params) != 7:
        raise PlanFaultError(f"{path}.params: expected 7 values, found {len(params)}")
    return params


def checked_param(name: str, number: float, where: str) -> float:
    """Return a mission parameter, a yaw wrapped to +-180 deg; raises PlanFaultError for values out of range."""
    if name == "yaw_deg":
        return math.remainder(number, 360.0)
    low, high, unit = _FLYABLE[name]
    if not low <= number <= high:
        raise PlanFaultError(f"{where}: {number:g} is out of range; allowed: {low:g} to {high:g} {unit}")
    return number


def _at(latitude: float, longitude: float, altitude: float, above: Above, height: float) -> Content:
    """Return a position as waypoint fields: place [deg], altitude [m], its reference, and height above home [m]."""
    return {
        "latitude_deg": latitude,
        "longitude_deg": longitude,
        "height_above_home": height,
        "altitude": altitude,
        "above": above,
    }


def _is_placeless(params: Sequence[object]) -> bool:
    """Return whether an item has no position, and so takes the one before: both coordinates null or 0."""
    return (params[4] is None and params[5] is None) or (params[4] == 0.0 and params[5] == 0.0)


def _apart(place: Home | RallyPoint, last: Waypoint) -> float:
    """Return a measure of the distance between two near places, for comparison with others only."""
    east = (place.longitude_deg - last.longitude_deg) * math.cos(math.radians(last.latitude_deg))
    return math.hypot(place.latitude_deg - last.latitude_deg, east)


def _not_flown(asked: list[str]) -> str:
    """Return the note "not flown: ..." that lists names; "" for none."""
    return f"not flown: {', '.join(asked)}" if asked else ""


def _why_refused(command: int, number: int) -> str:
    """Return the reason, for a message, why item ``number`` with this MAV_CMD cannot be flown."""
    row = known.COMMANDS.get(command)
    name = f"{command} ({row.name})" if row else str(command)
    if row and row.why:
        return f"{name}: {row.why}"
    return f"{name} cannot be flown (item {number}); flown: {known.flown_names()}"
