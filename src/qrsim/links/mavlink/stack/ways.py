"""Ways between two places of a plan that are no straight lines: over relief, and along splines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from qrsim.links.mavlink.stack.contracts import Item, Triple
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.fence import TERRAIN
from qrsim.links.mavlink.stack.plan import place_of
from qrsim.scenarios.plans import commands as known
from qrsim.scenarios.plans.heights import over_ground
from qrsim.scenarios.plans.splines import NONE, end_tangent, spline_points

# A difference of height that counts, and the least speed on a steep line [m], [m/s].
FLAT, SLOWEST = 0.3, 0.2
# Items to which a spline goes on without a stop.
_ONWARD = known.PLACES - {known.LAND, known.TAKEOFF}


class Way:
    """Places to pass on the way to a goal, in order; none of a straight line.

    Args:
        places: NED [m], without the begin and the goal.
        goal: NED [m].

    Attributes:
        bent: whether it bends anywhere.
    """

    def __init__(self, places: Sequence[Triple] = (), goal: Triple = (0.0, 0.0, 0.0)):
        self._places, self._goal = list(places), goal
        self.bent = bool(places)

    def through(self, here: Triple, radius: float) -> tuple[Triple, float] | None:
        """Return the next place to pass and how far the way goes on beyond it [m]; None: the goal is next.

        Args:
            here: where the vehicle is [m].
            radius: distance at which a place counts as passed [m].
        """
        while self._places and math.dist(here, self._places[0]) < radius:
            del self._places[0]
        if not self._places:
            return None
        return self._places[0], sum(math.dist(a, b) for a, b in pairwise([*self._places, self._goal]))

    def join(self, begin: Triple, here: Triple) -> None:
        """Leave out the places that lie behind a vehicle which joins the way from ``begin`` [m] elsewhere."""
        ends = [begin, *self._places, self._goal]
        nearest = min(range(len(ends) - 1), key=lambda i: _apart(here, ends[i], ends[i + 1]))
        del self._places[:nearest]


def steep(craft: Craft, place: Triple) -> Triple:
    """Return the speeds [m/s] at which a vehicle flies to a place on a straight line: level, up and down."""
    level, up, down = craft.speeds()
    here = craft.seen.position_ned
    away, rise = math.dist(here[:2], place[:2]), here[2] - place[2]
    if abs(rise) > FLAT:
        level = min(level, max(SLOWEST, away * (up if rise > 0.0 else down) / abs(rise)))
    return level, up, down


def way_to(items: Sequence[Item], item: Item, begin: Triple | None, goal: Triple, craft: Craft) -> Way:
    """Return the way to an item of a plan.

    Args:
        items: of the plan.
        item: one of them.
        begin: where the item before it was [m]; None: there was none.
        goal: where the item is [m].
        craft: that flies there.
    """
    here = craft.seen.position_ned
    seq = next(i for i, each in enumerate(items) if each is item)
    before = [each for each in items[:seq] if each.command in known.PLACES]
    places: list[list[float]] = []
    if item.command == known.SPLINE:
        first, last = _tangents(items, seq, before, begin, goal, craft)
        places = spline_points(begin or here, goal, first, last)[:-1]
    elif item.frame in TERRAIN and craft.facts.ground_down and begin and before and before[-1].frame in TERRAIN:
        places = over_ground(begin, goal, craft.facts.ground_down)
    way = Way([(place[0], place[1], place[2]) for place in places], goal)
    way.join(begin or here, here)
    return way


def _tangents(
    items: Sequence[Item], seq: int, before: Sequence[Item], begin: Triple | None, goal: Triple, craft: Craft
) -> tuple[Sequence[float], Sequence[float]]:
    """Return the tangents at both ends of a spline; there are none at a stop."""
    first: Sequence[float] = NONE
    if begin and len(before) > 1 and before[-1].command in known.WAYPOINTS and not before[-1].params[0] > 0.0:
        # A take-off without a place was at home.
        origin = place_of(before[-2], craft, craft.home.position_ned if craft.home else begin)
        ahead = goal if before[-1].command == known.SPLINE else begin
        first = [b - a for a, b in zip(origin, ahead, strict=True)]
    leads = (each for each in items[seq + 1 :] if each.command in known.PLACES or each.command == known.RETURN)
    after = next(leads, None)
    onward = after is not None and after.command in _ONWARD and not items[seq].params[0] > 0.0
    if after is None or not onward:
        return first, NONE
    onto = place_of(after, craft, goal)
    return first, end_tangent(begin or craft.seen.position_ned, goal, onto, after.command == known.SPLINE)


def _apart(here: Triple, begin: Triple, end: Triple) -> float:
    """Return the distance of a place from a straight line between two [m]."""
    way = [b - a for a, b in zip(begin, end, strict=True)]
    length2 = sum(each * each for each in way)
    along = sum((h - a) * each for h, a, each in zip(here, begin, way, strict=True))
    share = min(max(along / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
    return math.dist(here, [a + share * each for a, each in zip(begin, way, strict=True)])
