"""What vehicles feel of the wakes of others: at each rotor, as wind and as rotation; numbers by hand.

The upper vehicle is an X500 in hover 10 m up: 12.672 m/s on the axis, half of it 0.20179 m beside, until 2.1 m below.
That is at the density of sea level; speeds go with one over its root.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.core.vectors import rotation
from qrsim.world.wakes import wakes_on

# The density of ISO 2533 at 10 m is 0.999040, and at 3010 m 0.741376, of that at sea level.
AT_10_M, AT_3010_M = 1.000480, 1.161397


def pair(
    vehicle: dict[str, Any], place: list[float], controller: str = "cascade", down: float = -10.0, site: float = 0.0
) -> qrsim.Simulation:
    """Return a calm world of an X500 that hovers at a down coordinate [m], and a vehicle that heads north."""

    def fleet(vehicle: dict[str, Any], place: list[float], controller: str) -> dict[str, Any]:
        flown = {"type": controller, "feed": "truth"} if controller != "none" else {"type": "none"}
        return {"vehicle": vehicle, "controller": flown, "vehicles": [{"position_ned": place}]}

    content = {
        "name": "pair",
        "duration": 10.0,
        "site": {"height": site},
        "world": {
            "wind": "calm",
            "turbulence": "still",
            "collision_distance": 0.0,
            "area": {"type": "box", "z_min": -400.0},
        },
        "fleets": {
            "upper": fleet({"type": "multirotor"}, [0.0, 0.0, down], "cascade"),
            "lower": fleet(vehicle, place, controller),
        },
    }
    simulation = qrsim.load(content)
    simulation.reset()
    return simulation


def felt(
    vehicle: dict[str, Any], place: list[float], controller: str = "cascade", down: float = -10.0, site: float = 0.0
) -> Any:
    """Return the velocity (3,) in NED and the rotation (3,) in body axes that wakes add at the lower vehicle."""
    simulation = pair(vehicle, place, controller, down, site)
    fleet, state = simulation.world.fleets[1], simulation.state.fleets[1]
    pose = fleet.vehicle.pose(state.vehicle)
    wakes = wakes_on(simulation.world, simulation.state.fleets, fleet, pose, rotation(pose.attitude))
    return None if wakes is None else [np.asarray(part.stack())[0] for part in wakes]


@pytest.mark.parametrize(
    ("vehicle", "controller", "beside", "down", "rotation_"),
    [
        # Each rotor 0.24607 m, and 0.21 m, from the axis.
        ({"type": "multirotor"}, "cascade", 0.0, 4.85276, [0.0, 0.0, 0.0]),
        ({"type": "pelican"}, "cascade", 0.0, 6.03880, [0.0, 0.0, 0.0]),
        # The rotors are 0.3265, 0.46, 0.3265 and 0.04 m from it, on the left: that side is pushed down.
        ({"type": "pelican"}, "cascade", 0.25, 4.84453, [-26.1773, 0.0, 0.0]),
        ({"type": "pelican", "downwash": "at_centre"}, "cascade", 0.0, 12.6722, [0.0, 0.0, 0.0]),
        # Six parts of a span of 2.8956 m, -0.90298 rad/s, at an angle of attack of 0.05355 rad.
        ({"type": "fixed_wing"}, "fixed_wing", 0.25, 2.52410, [-0.901686, 0.0, 0.0]),
        ({"type": "fixed_point"}, "none", 0.0, 12.6722, [0.0, 0.0, 0.0]),
        # Level with it, nothing.
        ({"type": "pelican"}, "cascade", 3.0, 0.0, [0.0, 0.0, 0.0]),
    ],
)
def test_a_wake_is_felt_over_the_whole_vehicle(
    vehicle: dict[str, Any], controller: str, beside: float, down: float, rotation_: list[float]
) -> None:
    velocity, rates = felt(vehicle, [0.0, beside, -10.0 if beside == 3.0 else -8.0], controller)
    np.testing.assert_allclose(velocity, [0.0, 0.0, AT_10_M * down], rtol=2e-5, atol=1e-6)
    np.testing.assert_allclose(rates, AT_10_M * np.array(rotation_), rtol=2e-5, atol=2e-5)


def test_a_wake_is_faster_in_thin_air() -> None:
    velocity, _ = felt({"type": "multirotor"}, [0.0, 0.0, -8.0], site=3000.0)
    np.testing.assert_allclose(velocity, [0.0, 0.0, AT_3010_M * 4.85276], rtol=2e-5)


@pytest.mark.long
def test_many_are_compared_only_where_somebody_may_be_reached() -> None:
    """Of 48, more than the few of whom all pairs are compared, one is below another; then nobody is."""

    def felt_by(last: list[float]) -> Any:
        places = [[20.0 * (i // 8), 20.0 * (i % 8), -10.0] for i in range(47)]
        fleet = {
            "vehicle": {"type": "pelican"},
            "controller": {"type": "cascade", "feed": "truth"},
            "vehicles": [{"position_ned": place} for place in [*places, last]],
        }
        world = {"wind": "calm", "turbulence": "still", "collision_distance": 0.0}
        simulation = qrsim.load({"name": "many", "duration": 1.0, "world": world, "fleets": {"all": fleet}})
        simulation.reset()
        fleet, state = simulation.world.fleets[0], simulation.state.fleets[0]
        pose = fleet.vehicle.pose(state.vehicle)
        wakes = wakes_on(simulation.world, simulation.state.fleets, fleet, pose, rotation(pose.attitude))
        return np.asarray(wakes[0].z)

    below = felt_by([20.0, 40.0, -8.0])
    # Of a Pelican, 1.68 kg: sqrt(2 T/(rho A)) = 11.522 m/s; 0.21 m beside it is 0.47191 of that.
    assert below[47] == pytest.approx(AT_10_M * 5.4373, abs=1e-3)
    assert not below[:47].any()
    assert not felt_by([100.0, 140.0, -10.0]).any()


@pytest.mark.parametrize(("below", "down"), [(250.0, 0.1079), (290.0, 0.0)])
def test_it_ends_where_it_is_slow(below: float, down: float) -> None:
    """26.63 m^2/s, at 260 m 1.0126 times as much, over the distance: less than 0.1 m/s from 270 m on."""
    found = felt({"type": "fixed_point"}, [0.0, 0.0, -10.0], "none", -10.0 - below)
    assert found[0][2] == pytest.approx(down, abs=1e-3)


def test_it_can_be_left_out() -> None:
    assert felt({"type": "pelican", "downwash": "ignored"}, [0.0, 0.0, -8.0]) is None


@pytest.mark.long
@pytest.mark.parametrize("vehicle", ["pelican", "multirotor"])
def test_who_hovers_below_another_sinks(vehicle: str) -> None:
    sunk = []
    for downwash in ("felt", "ignored"):
        simulation = pair({"type": vehicle, "downwash": downwash}, [0.0, 0.0, -8.0])
        simulation.step(ticks=50)
        sunk.append(8.0 + float(simulation.truth.position_ned[1, 2]))
    assert sunk[0] > 0.02
    assert abs(sunk[1]) < 1e-3
