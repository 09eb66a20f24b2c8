"""Mission plans: what is accepted, and what each item asks for in the site's frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from qrsim.links.mavlink.stack.codes import UNSET_INT, PlanResult
from qrsim.links.mavlink.stack.contracts import FlavourName, Home, Item, Triple
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.fence import AMSL, GLOBAL, MOST_ITEMS, RELATIVE, bad_place
from qrsim.scenarios.plans.commands import (
    CHANGE_SPEED,
    CONDITION_DISTANCE,
    CONDITION_YAW,
    DELAY,
    FENCE_ENABLE,
    GATE,
    JUMP,
    LAND,
    LOITER_TURNS,
    MISSION_FRAME,
    PLACES,
    RETURN,
    SET_HOME,
    SKIPPED,
    TAKEOFF,
    taken_by,
)

# Items by flavour: those of the table of commands that its autopilot takes.
ACCEPTED: dict[FlavourName, frozenset[int]] = {"px4": taken_by("px4"), "ardupilot": taken_by("ardupilot")}
# Items that are over at some point of the way to the next place, and of which the next item may be that place.
ON_THE_WAY = frozenset((CONDITION_DISTANCE, GATE))
LARGEST_ALTITUDE = 1e5


def moves(command: int) -> bool:
    """Return whether a mission command (MAV_CMD) has an effect in this flight stack; others are accepted but
    skipped."""
    return command not in SKIPPED


def check(items: Sequence[Item], flavour: FlavourName) -> tuple[PlanResult, int]:
    """Check the items of a mission for PX4 or ArduPilot; return the MAV_MISSION_RESULT and the first invalid item's
    number or -1."""
    if len(items) > MOST_ITEMS:
        return PlanResult.NO_SPACE, MOST_ITEMS
    for index, item in enumerate(items):
        if item.command not in ACCEPTED[flavour]:
            return PlanResult.UNSUPPORTED, index
        bad = _bad_place(item) if item.command in PLACES or item.command in (SET_HOME, GATE) else None
        if bad is None:
            bad = _bad_numbers(item, len(items))
        if bad is not None:
            return bad, index
    return PlanResult.ACCEPTED, -1


def _bad_place(item: Item) -> PlanResult | None:
    """Return the result that refuses a mission item's frame or position; None if they are valid."""
    if item.frame not in GLOBAL and not (item.command == SET_HOME and item.frame == MISSION_FRAME):
        return PlanResult.UNSUPPORTED_FRAME
    if has_place(item):
        bad = bad_place(item)
        if bad is not None:
            return bad
    # A take-off has a height of its own; a landing, a gate and a new home need none.
    free = item.command in (TAKEOFF, LAND, GATE, SET_HOME) and math.isnan(item.z)
    return None if free or abs(item.z) <= LARGEST_ALTITUDE else PlanResult.INVALID_PARAM7


def _bad_numbers(item: Item, total: int) -> PlanResult | None:
    """Return the result that names a mission item's invalid parameter; None if all are valid. ``total``: number of
    items."""
    first, second, third, _ = item.params
    if any(math.isinf(number) for number in item.params):
        return (
            PlanResult.INVALID_PARAM1,
            PlanResult.INVALID_PARAM2,
            PlanResult.INVALID_PARAM3,
            PlanResult.INVALID_PARAM4,
        )[next(place for place, number in enumerate(item.params) if math.isinf(number))]
    if item.command == JUMP and not (first == first and 0 <= first < total and first == int(first)):
        return PlanResult.INVALID_PARAM1
    if item.command == FENCE_ENABLE and first == 0.0:
        return PlanResult.INVALID_PARAM1
    if item.command == CHANGE_SPEED:
        if first not in (0.0, 1.0, 2.0, 3.0):
            return PlanResult.INVALID_PARAM1
        return None if second in (-1.0, -2.0) or second > 0.0 else PlanResult.INVALID_PARAM2
    if item.command in (CONDITION_YAW, CONDITION_DISTANCE) and math.isnan(first):
        return PlanResult.INVALID_PARAM1
    if item.command == LOITER_TURNS and not first > 0.0:
        return PlanResult.INVALID_PARAM1
    return PlanResult.INVALID_PARAM3 if item.command == LOITER_TURNS and abs(third) > 1000.0 else None


def has_place(item: Item) -> bool:
    """Return whether a mission item has a latitude and longitude; (0, 0) and NaN count as none."""
    unset = (UNSET_INT, -UNSET_INT - 1)
    return item.x not in unset and item.y not in unset and not (item.x == 0 and item.y == 0)


def place_of(item: Item, craft: Craft, otherwise: Triple) -> Triple:
    """Return the position NED [m] of a mission item; coordinates that it lacks are taken from ``otherwise``."""
    home = craft.home
    z = otherwise[2]
    if math.isfinite(item.z):
        altitude = item.z
        if item.frame in RELATIVE:
            altitude += home.altitude if home else craft.geodesy.height
        elif item.frame not in AMSL:
            if craft.facts.ground_down is not None:
                return _above_ground(item, craft, otherwise)
            # Terrain is flat: the site's own height.
            altitude += craft.geodesy.height
        if has_place(item):
            return craft.geodesy.to_ned(item.x * 1e-7, item.y * 1e-7, altitude)
        z = craft.z_of_altitude(altitude)
    if has_place(item):
        north, east, _ = craft.geodesy.to_ned(item.x * 1e-7, item.y * 1e-7, craft.geodesy.height)
        return north, east, z
    return otherwise[0], otherwise[1], z


def _above_ground(item: Item, craft: Craft, otherwise: Triple) -> Triple:
    """Return the position NED [m] of a mission item whose altitude is above terrain; ``otherwise`` if it has no
    position."""
    ground_down = craft.facts.ground_down
    assert ground_down is not None
    north, east = otherwise[:2]
    if has_place(item):
        north, east, _ = craft.geodesy.to_ned(item.x * 1e-7, item.y * 1e-7, craft.geodesy.height)
    return north, east, float(ground_down(north, east)) - item.z


def next_place(items: Sequence[Item]) -> Item | None:
    """Return the first mission item with a position; None if a landing, take-off, return, delay or jump comes first."""
    for item in items:
        if item.command in PLACES - {LAND, TAKEOFF}:
            return item
        if item.command in (LAND, TAKEOFF, RETURN, DELAY, JUMP):
            return None
    return None


def set_home(item: Item, craft: Craft) -> None:
    """Obey DO_SET_HOME in a mission: move home to the item's position, or to the vehicle's if ``param1`` is 1 or it has
    none.

    In the frame of a mission, x and y are degrees times 1e7 too, as ArduPilot takes them, and z is an altitude above
    mean sea level.
    """
    if item.params[0] >= 0.5 or not has_place(item):
        craft.home_here()
        return
    if item.frame == MISSION_FRAME:
        item = replace(item, frame=AMSL[0])
    place = place_of(item, craft, craft.seen.position_ned)
    craft.set_home(Home(*craft.geodesy.to_geodetic(place), place, craft.seen.attitude[2]))


def outside(items: Sequence[Item], craft: Craft) -> int | None:
    """Return the sequence number of the first mission item outside the fence, area or distance limits; None if all are
    inside."""
    for index, item in enumerate(items):
        if item.command in PLACES and craft.home is not None and _too_far(item, craft, craft.home.position_ned):
            return index
        if item.command not in PLACES or not (has_place(item) or math.isfinite(item.z)):
            continue
        here = craft.seen.position_ned
        if not craft.allows(place_of(item, craft, (here[0], here[1], craft.home_z)), item.command == LAND):
            return index
    return None


def _too_far(item: Item, craft: Craft, home: Triple) -> bool:
    """Return whether a mission item is farther than GF_MAX_HOR_DIST or GF_MAX_VER_DIST [m] from home; 0 sets no
    limit."""
    far, high = craft.parameters["GF_MAX_HOR_DIST"], craft.parameters["GF_MAX_VER_DIST"]
    north, east, z = place_of(item, craft, home)
    return bool((far and math.hypot(north - home[0], east - home[1]) > far) or (high and home[2] - z > high))
