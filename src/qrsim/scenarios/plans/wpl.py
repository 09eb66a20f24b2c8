"""Reads lists of waypoints, QGC WPL 110 and 120, as Mission Planner, MAVProxy and QGroundControl save them.

A line has twelve values: number, current, frame, command, four parameters, latitude, longitude, altitude, autocontinue.
"""

from __future__ import annotations

import math

from qrsim.errors import ScenarioError, UsageError, readable, shortened
from qrsim.files.user_files import read_text
from qrsim.scenarios.plans import commands as known
from qrsim.scenarios.plans.parts import PlanFaultError, place_of
from qrsim.scenarios.plans.plan import Home, Ignored, Plan
from qrsim.scenarios.plans.route import Route

HEADER, VERSIONS, COLUMNS, MOST_LINES = "QGC WPL", ("110", "120"), 12, 20_000
_WHOLE = {0: "number", 2: "frame", 3: "command"}
Row = tuple[int, list[float]]


def read_wpl(source: str, home: Home | None = None) -> Plan:
    """Read a plan from a waypoint list in the format QGC WPL; ``home`` replaces that of the file.

    Item 0 is home where it is a waypoint above the sea, as in the files of Mission Planner; otherwise home is ``home``
    or the first place. A heading of 0 is along the way.

    Raises:
        UsageError: the file cannot be read or is of another version.
        ScenarioError: a line has no twelve numbers, or asks for what cannot be flown; every fault with its line.
    """
    rows = _rows(source)
    first_is_home = bool(rows) and int(rows[0][1][3]) == known.WAYPOINT and int(rows[0][1][2]) in known.ABOVE_SEA
    ignored = []
    if first_is_home:
        line, values = rows.pop(0)
        try:
            own = Home(*place_of(values[8:11], f"line {line}", 3))
        except PlanFaultError as fault:
            raise ScenarioError(source, [str(fault)]) from None
        if own.latitude_deg == own.longitude_deg == 0.0:
            ignored.append(Ignored(None, f"line {line}", "home at latitude 0 and longitude 0 is not used"))
        else:
            home = home or own
    if home is None:
        home = _first_place(rows)
    if home is None:
        raise UsageError(f"{source}: has no item with a place; give plan.home, [latitude, longitude]")
    route = Route(home)
    for line, values in rows:
        params: list[float | None] = [None if math.isnan(value) else value for value in values[4:11]]
        if params[3] == 0.0:
            params[3] = None
        content = {
            "command": int(values[3]),
            "frame": int(values[2]),
            "params": params,
            "doJumpId": int(values[0]),
            "autoContinue": values[11] != 0.0,
        }
        route.take(content, f"line {line}")
    route.fly()
    if route.problems:
        raise ScenarioError(source, [_by_column(problem) for problem in dict.fromkeys(route.problems)])
    return Plan(
        home=home,
        waypoints=tuple(route.waypoints),
        ignored=(*ignored, *dict.fromkeys(route.ignored)),
        delay=route.delay,
        again=route.again,
    )


def _rows(source: str) -> list[Row]:
    """Return (line number, values) of each item of a QGC WPL file."""
    with readable(source):
        text = read_text(source)
    lines = text.splitlines()
    words = lines[0].split() if lines else []
    if " ".join(words[:2]) != HEADER:
        raise UsageError(f"{source}: line 1: expected '{HEADER} 110', found '{shortened(' '.join(words), 40)}'")
    if (words[2:] and words[2] not in VERSIONS) or len(words) != 3:
        raise UsageError(
            f"{source}: line 1: '{shortened(' '.join(words), 40)}' is not supported; supported: {', '.join(VERSIONS)}"
        )
    if len(lines) > MOST_LINES:
        raise UsageError(f"{source}: has {len(lines)} lines; allowed: {MOST_LINES}")
    rows, problems = [], []
    for number, line in enumerate(lines[1:], 2):
        values = line.split()
        if not values or values[0].startswith("#"):
            continue
        try:
            rows.append((number, _numbers(values)))
        except PlanFaultError as fault:
            problems.append(f"line {number}: {fault}")
    if problems:
        raise ScenarioError(source, problems)
    return rows


def _numbers(values: list[str]) -> list[float]:
    """Parse the values of a line to numbers; raises PlanFaultError for a wrong count or value."""
    if len(values) != COLUMNS:
        raise PlanFaultError(f"{len(values)} values; expected {COLUMNS}")
    numbers = []
    for column, value in enumerate(values):
        try:
            number = float(value)
        except ValueError:
            raise PlanFaultError(f"column {column + 1}: '{shortened(value, 40)}' is no number") from None
        if math.isinf(number) or (column in _WHOLE and not (number == number // 1 and abs(number) < 1e6)):
            words = f"a whole number ({_WHOLE[column]})" if column in _WHOLE else "a finite number"
            raise PlanFaultError(f"column {column + 1}: '{shortened(value, 40)}' is not {words}")
        numbers.append(number)
    return numbers


def _first_place(rows: list[Row]) -> Home | None:
    """Return the first position of a waypoint list as home with unknown altitude; None without a position."""
    for _, values in rows:
        latitude, longitude = values[8:10]
        placed = int(values[3]) in known.PLACES and (latitude or longitude)
        if placed and abs(latitude) <= 90.0 and abs(longitude) <= 180.0:
            return Home(latitude, longitude)
    return None


def _by_column(problem: str) -> str:
    """Return a problem's text with the column of the QGC WPL file in place of the item's field."""
    for part, words in (*((f".params.{i}", f", column {i + 5}") for i in range(7)), (".command", ""), (".frame", "")):
        problem = problem.replace(f"{part}", words, 1) if problem.startswith("line ") else problem
    return problem.replace("doJumpId", "number")
