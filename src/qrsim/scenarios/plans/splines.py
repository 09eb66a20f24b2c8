"""Spline waypoints as ArduPilot flies them: a cubic between two places with a tangent at each.

AC_WPNav::set_spline_destination gives the tangents, SplineCurve::set_origin_and_destination shortens them where their
lengths together exceed four times the distance of the places.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from qrsim.scenarios.plans.heights import Floats

LONGEST_TANGENTS = 4.0
# Of the chords from the curve [m].
CHORD_ERROR = 0.2
MOST_PIECES = 100
NONE = (0.0, 0.0, 0.0)


def end_tangent(
    begin: Sequence[float], end: Sequence[float], after: Sequence[float] | None, after_is_spline: bool
) -> tuple[float, ...]:
    """Return the tangent (3,) [m] at a spline leg's end; ``after`` is the next place, None for a stop.

    Args:
        begin, end: of the spline [m].
        after: the next place [m]; None: it stops at its end.
        after_is_spline: whether another spline leads there.
    """
    if after is None:
        return NONE
    origin = begin if after_is_spline else end
    return tuple(b - a for a, b in zip(origin, after, strict=True))


def spline_points(
    begin: Sequence[float], end: Sequence[float], begin_tangent: Sequence[float], tangent: Sequence[float]
) -> list[list[float]]:
    """Return points (3,) [m] along a spline leg with these tangents at its ends, with its end but not its begin.

    Chords between them are within ``CHORD_ERROR`` of the curve.

    Args:
        begin, end: of the spline (3,) [m].
        begin_tangent, tangent: at both ends (3,) [m].
    """
    places = np.array([begin, end], np.float64)
    tangents = np.array([begin_tangent, tangent], np.float64)
    lengths, most = float(np.linalg.norm(tangents, axis=1).sum()), LONGEST_TANGENTS * math.dist(begin, end)
    if lengths > most:
        tangents *= most / lengths
    # The second derivative is linear in time, so it is largest at an end; a chord of h is off by at most h^2 / 8 of it.
    way = places[1] - places[0]
    bends = (6.0 * way - 4.0 * tangents[0] - 2.0 * tangents[1], -6.0 * way + 2.0 * tangents[0] + 4.0 * tangents[1])
    bend = max(float(np.linalg.norm(each)) for each in bends)
    count = min(max(1, math.ceil(math.sqrt(bend / (8.0 * CHORD_ERROR)))), MOST_PIECES)
    time = np.linspace(0.0, 1.0, count + 1)[1:, None]
    curve = _cubic(places, tangents, time)
    return [[float(each) for each in place] for place in (*curve[:-1], places[1])]


def _cubic(places: Floats, tangents: Floats, time: Floats) -> Floats:
    """Return the cubic Hermite curve through two places with given tangents, at times from 0 to 1."""
    square, cube = time**2, time**3
    return np.asarray(
        (2.0 * cube - 3.0 * square + 1.0) * places[0]
        + (cube - 2.0 * square + time) * tangents[0]
        + (3.0 * square - 2.0 * cube) * places[1]
        + (cube - square) * tangents[1]
    )
