"""What vehicles feel of the wakes of others: at each rotor, as wind and as rotation; numbers by hand.

The upper vehicle is an X500 in hover 10 m up: 12.672 m/s on the axis, half of it 0.20179 m beside, until 2.1 m below.
That is at the density of sea level; speeds go with one over its root.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3, rotation
from qrsim.engine.settings import quick_jit
from qrsim.world import wakes as module
from qrsim.world.wakes import wakes_of, wakes_on

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
    wakes = felt_by(simulation.world, simulation.state.fleets)[1]
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


def felt_by(world: Any, states: Any) -> list[Any]:
    """Return what ``wakes_on`` returns for each fleet."""
    wakes, found = wakes_of(world, states), []
    for each, state in zip(world.fleets, states, strict=True):
        pose = each.vehicle.pose(state.vehicle)
        found.append(wakes_on(world, wakes, each, pose, rotation(pose.attitude)))
    return found


@pytest.mark.long
def test_who_is_near_a_wake_is_found_without_a_look_at_all_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two fleets at random places, in all airs, of which some have stopped, by both ways."""
    rng = np.random.default_rng(2)

    def fleet(vehicle: str, count: int, first: float) -> dict[str, Any]:
        places = [{"position_ned": [first + 3.0 * i, 0.0, -30.0]} for i in range(count)]
        return {"vehicle": {"type": vehicle}, "controller": {"type": "cascade", "feed": "truth"}, "vehicles": places}

    fleets = {"few": fleet("pelican", 30, 0.0), "more": fleet("multirotor", 25, 200.0)}
    world = {"wind": "calm", "turbulence": "still", "collision_distance": 0.0}
    simulation = qrsim.load({"name": "many", "duration": 1.0, "world": world, "fleets": fleets})
    simulation.reset()

    def moved(state: Any, width: float, blown: float) -> Any:
        n, like = state.violation.code.shape[0], state.mean_wind_ned.x.dtype

        def vectors(values: Any) -> Any:
            return Vec3.of(jnp.asarray(values, like))

        place = rng.uniform([-width, -width, -30.0], [width, width, -10.0], (n, 3))
        code = np.where(rng.random(n) < 0.1, 1, 0).astype(np.int32)
        return replace(
            state,
            vehicle=replace(state.vehicle, position_ned=vectors(place)),
            violation=replace(state.violation, code=jnp.asarray(code)),
            mean_wind_ned=vectors(rng.normal(0.0, blown, (n, 3))),
        )

    def felt_as(few: int) -> Any:
        def felt(states: Any) -> Any:
            monkeypatch.setattr(module, "FEW", few)
            found = [[part.stack() for part in each] for each in felt_by(simulation.world, states)]
            return found, [each and each.total for each in wakes_of(simulation.world, states).reaching]

        return quick_jit(felt)

    by_pairs, one_by_one = felt_as(1000), felt_as(1)
    reached, compared = [], []
    for width, blown in ((10.0, 1.0), (10.0, 8.0), (15.0, 20.0), (300.0, 8.0)):
        states = tuple(moved(state, width, blown) for state in simulation.state.fleets)
        pairs, _ = by_pairs(states)
        found, looked_at = one_by_one(states)
        for one, other, state in zip(found, pairs, states, strict=True):
            flies = np.asarray(state.violation.code) == 0
            for part, expected, close in zip(one, other, (1e-5, 1e-4), strict=True):
                np.testing.assert_allclose(part[flies], expected[flies], rtol=1e-4, atol=close)
        reached.append(sum(int(np.asarray(each[0]).any(axis=1).sum()) for each in pairs))
        compared.append(sum(int(each) for each in looked_at))
    # Of 55; hundreds of metres apart, few are looked at.
    assert min(reached[:3]) > 8
    assert reached[3] <= compared[3] < 20


@pytest.mark.parametrize(("below", "down"), [(250.0, 0.1079), (290.0, 0.0)])
def test_it_ends_where_it_is_slow(below: float, down: float) -> None:
    """26.63 m^2/s, at 260 m 1.0126 times as much, over the distance: less than 0.1 m/s from 270 m on."""
    found = felt({"type": "fixed_point"}, [0.0, 0.0, -10.0], "none", -10.0 - below)
    assert found[0][2] == pytest.approx(down, abs=1e-3)


def test_it_can_be_left_out() -> None:
    assert felt({"type": "pelican", "downwash": "ignored"}, [0.0, 0.0, -8.0]) is None


@pytest.mark.long
@pytest.mark.parametrize("vehicle", ["pelican", pytest.param("multirotor", marks=pytest.mark.nightly)])
def test_who_hovers_below_another_sinks(vehicle: str) -> None:
    sunk = []
    for downwash in ("felt", "ignored"):
        simulation = pair({"type": vehicle, "downwash": downwash}, [0.0, 0.0, -8.0])
        simulation.step(ticks=50)
        sunk.append(8.0 + float(simulation.truth.position_ned[1, 2]))
    assert sunk[0] > 0.02
    assert abs(sunk[1]) < 1e-3
