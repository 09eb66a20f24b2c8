"""Plans of missions by hand.

From ramps, corners, polynomials and landings of docs/explanation/models/control.md, C18 to C21.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from qrsim.control.paths import Leg, Limits, _highest, corner_speed, flown_seconds, mission_of, plan, renumbered

LIMITS = Limits()
HOME = (0.0, 0.0, -20.0)


def north(way: float, **own: object) -> Leg:
    """A leg that ends so far north of home."""
    return Leg((way, 0.0, -20.0), **own)  # type: ignore[arg-type]


def test_a_short_leg_has_the_peak_of_two_ramps_that_meet() -> None:
    """Ramps of 1.5 v/3 s, way v^2/4 m each: 8 m are two ramps to 4 m/s, of 2 s."""
    (part,) = plan(HOME, [north(8.0)], LIMITS)
    assert [part.peak, part.rise, part.cruise, part.fall] == pytest.approx([4.0, 2.0, 0.0, 2.0], abs=1e-9)


def test_sixty_halvings_find_a_speed() -> None:
    """They take 2^60 to 1: what is found below 1.5 is 1."""
    assert _highest(0.0, 2.0**60, lambda speed: speed <= 1.5) == 1.0


def test_straight_on_and_straight_back() -> None:
    """Directions whose product is rounded to more than 1 in magnitude are turned by 0 and pi, and not by none.

    A turn by pi from 2 m before its corner: sqrt(3 m/s^2 2 m / 1.5) = 2 m/s, less than cbrt(8 4 / 3) = 2.2 m/s.
    """
    beyond = set()
    for east in range(1, 30):
        way = np.array([10.0, east, 0.0])
        ahead = way / np.linalg.norm(way)
        beyond.add(float(ahead @ ahead) > 1.0)
        first = tuple(way)
        on = plan((0.0, 0.0, 0.0), [Leg(first), Leg(tuple(2.0 * way))], LIMITS)
        back = plan((0.0, 0.0, 0.0), [Leg(first), Leg((0.0, 0.0, 0.0))], LIMITS)
        assert on[0].leave == pytest.approx(5.0, rel=1e-9)
        assert back[0].leave == pytest.approx(2.0, rel=1e-6)
    assert beyond == {False, True}


def test_a_turn_of_two_millionths_is_none() -> None:
    """C19 with sin(A/2) = 1.05e-6: cbrt(8 m/s^3 (2 m)^2 / (3 sin)) = 216.6 m/s; below 1e-6 there is no limit."""
    assert corner_speed(2.0, 2.1e-6, LIMITS) == pytest.approx(math.cbrt(32.0 / 3.15e-6))
    assert corner_speed(2.0, 1.9e-6, LIMITS) == math.inf


# A ramp to 0.3 m/s takes sqrt(6 0.3/8) s, at 0.15 m/s in the mean [m].
SLOW_RAMP = 0.15 * math.sqrt(0.225)


@pytest.mark.parametrize("share", [0.8, 1.0 - 0.5e-9, 1.0, 1.0 + 0.9e-9, 1.0 + 1.1e-9, 1.1])
def test_a_leg_too_short_for_its_ramp_lowers_the_faster_corner(share: float) -> None:
    """C19, straight on at 0.3 m/s 1 cm before the end of the first leg: to the bit where the ramp fits within 1e-9."""
    legs = [north(SLOW_RAMP / share + 0.01, speed=0.3, accept_radius=0.01), north(9.0, speed=0.3)]
    first = plan(HOME, legs, LIMITS)[0]
    if share <= 1.0 + 1e-9:
        assert first.leave == 0.3
    else:
        # Ways of such ramps are as speeds to the power of 1.5.
        assert first.leave == pytest.approx(0.3 * share ** (-2.0 / 3.0), rel=1e-12)


def test_lines_have_a_direction_from_a_millimetre_on() -> None:
    """Of 0.9 mm there is no line, of 1.1 mm there is."""
    assert [plan(HOME, [north(way)], LIMITS)[0].length for way in (0.0009, 0.0011)] == pytest.approx([0.0, 0.0011])


@pytest.mark.parametrize(
    ("acceleration", "jerk", "seconds"),
    [
        (0.5, 100.0, math.sqrt(10.0 / math.sqrt(3.0) * 40.0 / 0.5)),
        (100.0, 0.1, 28.844991406),  # The cube root of 60 * 40/0.1 = 24000.
        (100.0, 100.0, 15.0),
    ],
)
def test_a_polynomial_keeps_speed_acceleration_and_jerk(acceleration: float, jerk: float, seconds: float) -> None:
    """Of 10 x^3 - 15 x^4 + 6 x^5 the derivatives are at most 15/8, 10/sqrt(3) and 60; 40 m at 5 m/s."""
    limits = Limits(acceleration=acceleration, jerk=jerk, quintic=True)
    (part,) = plan(HOME, [north(40.0)], limits)
    assert flown_seconds(part) == pytest.approx(seconds, rel=1e-9)
    assert part.peak == pytest.approx(40.0 / seconds, rel=1e-9)


def test_seconds_of_a_landing_from_forty_metres() -> None:
    """C18 and C21: to 1.5 m/s in sqrt(1.125) s, from there to 0.7 m/s in sqrt(0.6) s, above 10 m; 10 m at 0.7 m/s."""
    down, slower = math.sqrt(1.125), math.sqrt(0.6)
    cruise = (30.0 - 0.75 * down - 1.1 * slower) / 1.5
    (part,) = plan((0.0, 0.0, -40.0), [Leg((0.0, 0.0, 0.0), "land")], LIMITS)
    assert [part.rise, part.cruise, part.fall, part.leave] == pytest.approx([down, cruise, slower, 0.7])
    assert flown_seconds(part) == pytest.approx(down + cruise + slower + 10.0 / 0.7)


def test_what_lasts_for_ever_is_a_thousand_million_seconds() -> None:
    mission = mission_of([plan(HOME, [north(8.0, hold=math.inf)], LIMITS)], [None], LIMITS)
    assert np.asarray(mission.hold_s).item() == 1e9


def test_legs_are_counted_as_their_author_does() -> None:
    """From 1; the parts of one leg have its number, and the last part says so."""
    assert np.asarray(mission_of([plan(HOME, [north(8.0)], LIMITS)], [None], LIMITS).number).item() == 1
    parts = renumbered([north(8.0), north(9.0), north(9.5)], 7)
    assert [(part.number, part.last) for part in parts] == [(7, False), (7, False), (7, True)]
