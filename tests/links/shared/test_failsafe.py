"""What a vehicle is ordered to do in silence, by what it takes: each a number by hand."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.links.contracts import Order
from qrsim.links.shared.failsafe import failsafe

ALL = ("waypoint", "velocity", "attitude")
# Position NED [m] and heading [rad], and where it started.
BELIEVED, HOME = np.array([3.0, -4.0, -12.0, 0.3]), np.array([1.0, 2.0, -10.0])


@pytest.mark.parametrize(
    ("does", "kinds", "kind", "numbers"),
    [
        ("hold", ALL, "waypoint", (3.0, -4.0, -12.0, 0.3)),
        # Above its start, at the height and heading that it has.
        ("return", ALL, "waypoint", (1.0, 2.0, -12.0, 0.3)),
        # Level, at its heading, without thrust.
        ("stop", ALL, "attitude", (0.0, 0.0, 0.3, 0.0)),
        ("hold", ("velocity",), "velocity", (0.0, 0.0, 0.0, 0.3)),
        ("return", ("velocity",), "velocity", (0.0, 0.0, 0.0, 0.3)),
    ],
)
def test_a_failsafe_is_an_order(does, kinds, kind, numbers):
    assert failsafe(does, "a", BELIEVED, HOME, kinds) == Order("a", kind, numbers)


@pytest.mark.parametrize(("does", "kinds"), [("hold", ("control",)), ("return", ()), ("stop", ("waypoint",))])
def test_who_takes_no_such_order_flies_by_its_guidance(does, kinds):
    assert failsafe(does, "a", BELIEVED, HOME, kinds) is None
