"""Reads QGroundControl .plan files: home, items, fence and rally points.

The format is that of QGroundControl's developer guide, "Plan File Format"; commands and frames are MAVLink's MAV_CMD
and MAV_FRAME.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from qrsim.errors import ScenarioError
from qrsim.scenarios.plans.commands import NO_VTOL
from qrsim.scenarios.plans.fences import PlannedFence, rally_points
from qrsim.scenarios.plans.parts import (
    PlanFaultError,
    check_kind,
    number_of,
    of_kind,
    part_of,
    place_of,
    plan_content,
    section_of,
    shown,
    with_lines,
)
from qrsim.scenarios.plans.patterns import LANDING, SCAN, VTOL_LANDING, Generated, landing_items, scan_items
from qrsim.scenarios.plans.plan import Home, Plan
from qrsim.scenarios.plans.route import LARGEST_SPEED, Route

TRANSECTS = "TransectStyleComplexItem"
_GENERATED = {SCAN: scan_items, LANDING: landing_items}


def read_qgc(source: str) -> Plan:
    """Read a .plan file of QGroundControl (version 1, mission version 2, fence version 2).

    Jumps are followed; an endless one is followed once and then leads to ``again``. An item without a place or altitude
    has that of the item before it. A return is a waypoint above home or the nearest rally point. What a mission does at
    its waypoints (speeds, holds, delays, headings, circles) is theirs; cameras and gimbals are in ``ignored``.

    Raises:
        UsageError: the file cannot be read or is no JSON.
        ScenarioError: it is no plan, of another version, or asks for what cannot be flown; every fault with its path.
    """
    content = plan_content(source)
    try:
        check_kind(content)
        mission = section_of(content, "mission", 2)
        home = Home(
            *place_of(part_of(mission, "plannedHomePosition", list, "mission"), "mission.plannedHomePosition", 3)
        )
        items = part_of(mission, "items", list, "mission")
        hover, cruise = (_speed(mission, name) for name in ("hoverSpeed", "cruiseSpeed"))
    except PlanFaultError as fault:
        raise ScenarioError(source, [str(fault)]) from None
    rally, problems = rally_points(content)
    route, fence = Route(home, rally), PlannedFence()
    _take_all(route, items, "mission.items")
    route.fly()
    fence.add_all(content)
    if problems := [*dict.fromkeys(route.problems), *fence.problems, *problems]:
        raise ScenarioError(source, with_lines(source, problems))
    return Plan(
        home=home,
        waypoints=tuple(route.waypoints),
        polygons=tuple(fence.polygons),
        circles=tuple(fence.circles),
        ignored=(*dict.fromkeys(route.ignored), *fence.ignored),
        delay=route.delay,
        again=route.again,
        rally=tuple(rally),
        hover_speed=hover,
        cruise_speed=cruise,
    )


def _speed(mission: Mapping[str, object], name: str) -> float | None:
    """Return a speed [m/s] that a .plan file gives for its whole mission; None without one."""
    value = mission.get(name)
    if value is None:
        return None
    speed = number_of(value, f"mission.{name}", LARGEST_SPEED, "m/s")
    return speed if speed > 0.0 else None


def _take_all(route: Route, items: list[Any], where: str, inside: bool = False) -> None:
    """Add a .plan file's mission items to a route, recording problems; ``inside``: they are part of a survey."""
    for i, item in enumerate(items):
        path = f"{where}.{i}"
        try:
            kind = of_kind(item, dict, path).get("type")
            if kind == "ComplexItem" and not inside:
                _take_complex(route, item, path)
            elif kind == "SimpleItem":
                route.take(item, path)
            else:
                supported = "'SimpleItem'" if inside else "'SimpleItem', 'ComplexItem'"
                raise PlanFaultError(f"{path}.type: is {shown(kind)}; supported: {supported}")
        except PlanFaultError as fault:
            route.problems.append(str(fault))


def _take_complex(route: Route, item: Mapping[str, object], path: str) -> None:
    """Add the items of a survey, structure scan or landing pattern of a .plan file to a route."""
    kind = item.get("complexItemType")
    if kind == VTOL_LANDING:
        raise PlanFaultError(f"{path}: {shown(kind)}: {NO_VTOL}")
    if isinstance(kind, str) and kind in _GENERATED:
        made: list[Generated] = _GENERATED[kind](item, path)
        for content, side_deg in made:
            route.take(content, path, side_deg)
        return
    if TRANSECTS not in item:
        raise PlanFaultError(
            f"{path}: a ComplexItem of type {shown(kind)} cannot be flown; supported: those with {TRANSECTS}.Items, "
            f"such as 'survey' and 'CorridorScan', and {', '.join(map(repr, _GENERATED))}"
        )
    inner = part_of(item, TRANSECTS, dict, path)
    if inner.get("version", 1) not in (1, 2):
        raise PlanFaultError(
            f"{path}.{TRANSECTS}.version: version {shown(inner['version'])} is not supported; supported: 1, 2"
        )
    items = part_of(inner, "Items", list, f"{path}.{TRANSECTS}")
    if not items:
        raise PlanFaultError(f"{path}: {TRANSECTS}.Items is empty; open and save the plan in QGroundControl")
    _take_all(route, items, f"{path}.{TRANSECTS}.Items", inside=True)
