"""Parts of the sensors that look at other vehicles, each by hand: cone, walls, noise across, false alarms, turns."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_rangefinder import solids, vector
from tests.by_numpy import uncompiled

from qrsim.core.vectors import Euler, Vec3
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.traffic import Traffic
from qrsim.models.sensors import neighbours, ranging
from qrsim.models.sensors.neighbours import IdealNeighbours, NeighbourSensor
from qrsim.models.sensors.ranging import Ranging
from qrsim.models.sensors.scan import spheres_met

Array = np.ndarray[Any, Any]
DEEP: Any = FlatGround(height=np.float32(-100.0))  # type: ignore[arg-type]


class Normals:
    """Draws of which the r-th row of normals is (r + 1) times a step, and every chance is the same."""

    def __init__(self, vehicles: int, step: float = 0.0, chance: float = 0.5) -> None:
        self.vehicles, self.step = vehicles, step
        self.asked: list[tuple[int, int]] = []
        self.pairs: list[int] = []
        # Uniform numbers of variance 1 are within the root of 3.
        self.spread = (2.0 * chance - 1.0) * math.sqrt(3.0)

    def normal_rows(self, rows: int, first: int = 0) -> Any:
        self.asked.append((rows, first))
        rising = (first + 1.0 + np.arange(rows)) * self.step
        return jnp.asarray(np.repeat(rising[:, None], self.vehicles, axis=1), jnp.float32)

    def uniform_pairs(self, pairs: Any) -> Any:
        self.pairs.append(len(pairs))
        return (jnp.full((len(pairs), self.vehicles), self.spread, jnp.float32),) * 2


def traffic(places: Any, velocities: Any = None, first: int = 0) -> Traffic:
    at = np.asarray(places, np.float32)
    moving = np.zeros_like(at) if velocities is None else np.asarray(velocities, np.float32)
    count = len(at)
    place, velocity = (Vec3(*(jnp.asarray(axis) for axis in numbers.T)) for numbers in (at, moving))
    return Traffic(place, velocity, jnp.ones(count, bool), jnp.ones(count), ("a",), (count,), first)


def level(count: int) -> Euler:
    return Euler(*(jnp.zeros(count),) * 3)


def seen(target: tuple[float, float, float], fov: float, box: tuple[float, ...] = ()) -> bool:
    """Return whether one at 20 m of height that looks north sees another at a place against it."""
    both = traffic([[0.0, 0.0, -20.0], np.add([0.0, 0.0, -20.0], target)])
    sensor = NeighbourSensor(slots=1, field_of_view_rad=fov, missed=0.0, false_alarms=0.0)  # type: ignore[arg-type]
    own = both.position_ned.map(lambda axis: axis[:1])
    found, _ = uncompiled(sensor.look)(Normals(1), own, level(1), solids(box), DEEP, both)  # type: ignore[arg-type]
    return float(found.count[0]) == 1.0


@pytest.mark.parametrize(
    ("bearing", "fov", "inside"),
    # Half the angle of the cone on each side; a millionth for rounding.
    [
        (0.95, 2.0, True),
        (1.05, 2.0, False),
        (-0.95, 2.0, True),
        (0.5 * math.pi + 0.9e-6, math.pi, True),
        (0.5 * math.pi + 1.1e-6, math.pi, False),
    ],
)
def test_the_cone(bearing: float, fov: float, inside: bool) -> None:
    assert seen((10.0 * math.cos(bearing), 10.0 * math.sin(bearing), 0.0), fov) is inside


@pytest.mark.parametrize(("begins", "inside"), [(9.89, False), (9.91, True)])
def test_what_is_within_a_tenth_of_a_metre_of_the_other_hides_it_not(begins: float, inside: bool) -> None:
    assert seen((10.0, 0.0, 0.0), 2.0, (begins, 12.0, -1.0, 1.0, -25.0, -15.0)) is inside


@pytest.mark.parametrize(
    ("unit", "moved"),
    # Across forward: down by the first angle, left by the second; across right: up and backward.
    [
        ((1.0, 0.0, 0.0), (1.0, -0.2, 0.1)),
        ((0.0, 1.0, 0.0), (-0.2, 1.0, -0.1)),
        # Within 0.9 of forward it is as if right; at half of it, across forward.
        ((0.95, 0.31225, 0.0), (0.95 + 0.2 * 0.31225, 0.31225 - 0.2 * 0.95, 0.1)),
        ((0.5, 0.8660254, 0.0), (0.5 - 0.2 * 0.8660254, 0.8660254 + 0.2 * 0.5, -0.1)),
    ],
)
def test_two_small_angles_across(unit: Any, moved: Any) -> None:
    found = uncompiled(neighbours._deflected)(vector(*unit), jnp.array([0.1]), jnp.array([0.2]))
    expected = np.array(moved) / math.sqrt(1.05)
    np.testing.assert_allclose(np.ravel(found.stack()), expected, atol=2e-6)


def test_false_alarms_are_even_over_the_cone_and_over_distances() -> None:
    """A quarter from cos 1 towards 1, at a quarter of a turn from the back, at half of the reach of 10 m."""
    found = uncompiled(neighbours._random_places)(jnp.array([[0.25], [0.25], [0.5]]), 2.0, jnp.array(10.0))
    np.testing.assert_allclose(np.ravel(found.stack()), [3.276134, -3.777160, 0.0], atol=2e-5)


@pytest.mark.long
def test_noise_of_a_reading_by_hand() -> None:
    """Rows of normals: range, two angles across, then velocity north, east, down, one for each slot."""
    places = [[0.0, 0.0, -20.0], [10.0, 0.0, -20.0], [0.0, 20.0, -20.0]]
    both = traffic(places, [[1.0, 2.0, 3.0], [0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    noise: Any = {"bearing_noise": 0.0, "range_noise": 1.0, "range_noise_share": 0.1, "velocity_noise": 2.0}
    sensor = NeighbourSensor(slots=2, velocity=True, identity=False, missed=0.0, false_alarms=0.0, **noise)  # type: ignore[arg-type]
    draw = Normals(1, step=0.1)
    own = both.position_ned.map(lambda axis: axis[:1])
    found, _ = uncompiled(sensor.look)(draw, own, level(1), solids(), DEEP, both)  # type: ignore[arg-type]
    assert draw.asked == [(12, 0)]
    # A chance for each slot to be missed, and four for a false alarm: whether, and where.
    assert draw.pairs == [3]
    # Spread 1 + 0.1 d; normals 0.1 and 0.2 for the two.
    assert [float(item[0]) for item in found.distance] == pytest.approx([10.0 + 2.0 * 0.1, 20.0 + 3.0 * 0.2])
    # Normals 0.7 to 1.2 times 2 m/s: the first of each pair for the nearer one.
    velocities = np.array([np.ravel(item.stack()) for item in found.velocity])
    np.testing.assert_allclose(
        velocities, [[-1.0 + 1.4, -2.0 + 1.8, -3.0 + 2.2], [3.0 + 1.6, -2.0 + 2.0, -3.0 + 2.4]], rtol=1e-5
    )
    assert [float(item[0]) for item in found.vehicle] == [-1.0, -1.0]
    still = NeighbourSensor(slots=2, missed=0.0, false_alarms=0.0)  # type: ignore[arg-type]
    draw = Normals(1)
    uncompiled(still.look)(draw, own, level(1), solids(), DEEP, both)  # type: ignore[arg-type]
    assert draw.asked == [(6, 0)]


def test_rows_of_those_who_look() -> None:
    """From the first of the fleet on, and never past the last of the world."""
    three = traffic(np.zeros((3, 3)), first=1)
    two, four = (Vec3(*(jnp.zeros(n),) * 3) for n in (2, 4))
    assert np.asarray(neighbours._rows(two, three)).tolist() == [1, 2]
    assert np.asarray(neighbours._rows(four, three)).tolist() == [1, 2, 2, 2]


@pytest.mark.parametrize(("vehicles", "can_be_crowded"), [(193, False), (194, True)])
def test_a_crowd_is_more_than_three_times_64_others(vehicles: int, can_be_crowded: bool) -> None:
    all_of_them = traffic(np.arange(3 * vehicles).reshape(-1, 3) * 30.0)
    sensor = IdealNeighbours(slots=1)
    state, _ = uncompiled(sensor.init)(None, all_of_them.position_ned, level(vehicles), solids(), DEEP, all_of_them)
    assert (state is not None) is can_be_crowded


@uncompiled
def exchange_of(sensor: Any, others: Traffic) -> Any:
    """Return the places of exchanges on the channel, and how many there are."""
    return ranging._partners(sensor, others.position_ned, others).exchange()


def test_turns_on_the_channel() -> None:
    """Two beacons, three vehicles: each has 2 + 2 exchanges, of vehicle v from 4 v on; the next vehicle is first."""
    beacons = Vec3(*(jnp.zeros(2),) * 3)
    sensor = SimpleNamespace(beacon_ned=beacons, vehicles="all")
    three = traffic([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    number, count = exchange_of(sensor, three)
    assert count == 12
    found = np.asarray(number)
    assert found[:2].tolist() == [[0, 4, 8], [1, 5, 9]]
    others = found[2:][~np.eye(3, dtype=bool)].tolist()
    # To vehicle 0: by 1 second, by 2 first; to 1: by 0 first, by 2 second; to 2: by 0 second, by 1 first.
    assert others == [7, 10, 2, 11, 3, 6]
    alone = traffic([[0.0, 0.0, 0.0]])
    assert exchange_of(sensor, alone)[1] == 2
    only = SimpleNamespace(beacon_ned=None, vehicles="all")
    assert exchange_of(only, three)[1] == 6


@pytest.mark.parametrize(
    ("box", "hidden"),
    # Antennas are 0.1 m up; what ends 0.1 m before the other's is not in the way.
    [
        ((4.0, 6.0, -1.0, 1.0, -20.09, 0.0), False),
        ((4.0, 6.0, -1.0, 1.0, -20.11, 0.0), True),
        ((9.89, 12.0, -1.0, 1.0, -25.0, 0.0), True),
        ((9.91, 12.0, -1.0, 1.0, -25.0, 0.0), False),
    ],
)
def test_what_stands_between_antennas(box: tuple[float, ...], hidden: bool) -> None:
    both = traffic([[0.0, 0.0, -20.0], [10.0, 0.0, -20.0]])

    def behind() -> Any:
        partners = ranging._partners(SimpleNamespace(beacon_ned=None, vehicles="all"), both.position_ned, both)
        return ranging.behind(solids(box), DEEP, both.position_ned, partners)

    assert bool(uncompiled(behind)()[1, 0]) is hidden


SURE = {"dropouts": 0.0, "noise_std": 0.0, "exchanges": 0, "beacons": (), "range_max": 1000.0, "fading": 1.0}


def measured(given: dict[str, Any], chance: float, box: tuple[float, ...] = (), step: float = 0.0) -> float:
    """Return the range between two that are 10 m apart, as the first has it."""
    both = traffic([[0.0, 0.0, -20.0], [10.0, 0.0, -20.0]])
    sensor = Ranging(**{**SURE, **given})
    draw = Normals(2, step, chance)
    state, found = uncompiled(sensor.init)(draw, both.position_ned, solids(box), DEEP, both)  # type: ignore[arg-type]
    # After those of the ranges to both and one more, two for each path.
    assert draw.asked == ([(4, 3), (2, 0)] if box else [(2, 0)])
    draw.asked.clear()
    uncompiled(sensor.step)(state, draw, both.position_ned, solids(box), DEEP, both)  # type: ignore[arg-type]
    assert draw.asked == ([(4, 3), (2, 0)] if box else [(2, 0)])
    return float(found.vehicle_range[1][0])


WALL = (4.0, 6.0, -1.0, 1.0, -30.0, 0.0)


@pytest.mark.parametrize(
    ("given", "share", "box"),
    [
        ({"dropouts": 0.3}, 0.7, ()),
        ({"dropouts": 0.1, "nlos_dropouts": 0.5}, 0.45, WALL),
        ({"dropouts": 0.1, "nlos_dropouts": 0.5}, 0.9, (4.0, 6.0, 5.0, 7.0, -30.0, 0.0)),
        # 1 / (1 + e^x): half at the largest range, 1 / (1 + 1 / e) one metre before it, none beyond.
        ({"range_max": 10.0}, 0.5, ()),
        ({"range_max": 11.0}, 0.731059, ()),
        ({"range_max": 9.0}, 0.268941, ()),
    ],
)
def test_share_of_ranges_that_come(given: dict[str, Any], share: float, box: tuple[float, ...]) -> None:
    given = {"nlos_bias": 0.0, **given}
    assert measured(given, share - 0.01, box) == pytest.approx(10.0)
    assert math.isnan(measured(given, share + 0.01, box))


def test_bias_behind_something() -> None:
    """Half the sum of the squares of the normals of rows 5 and 7, times the mean: 0.5 (0.25 + 0.49) 2 = 0.74 m."""
    assert measured({"nlos_bias": 2.0, "nlos_dropouts": 0.0}, 0.1, WALL, 0.1) == pytest.approx(10.74, rel=1e-5)
    assert measured({"nlos_bias": 2.0, "nlos_dropouts": 0.0}, 0.1, (), 0.1) == pytest.approx(10.0)


def test_a_ray_that_meets_nobody_has_slopes() -> None:
    """Of one that looks north past another in the east: no distance, and none that changes."""

    def met(north: Any) -> Any:
        both = traffic([[0.0, 0.0, -20.0], [0.0, 50.0, -20.0]])
        own = Vec3(north, jnp.zeros(1), jnp.full(1, -20.0))
        ahead = Vec3(*(jnp.full((1, 1), axis) for axis in (1.0, 0.0, 0.0)))
        distance = spheres_met(both, own, ahead)
        return jnp.sum(jnp.where(jnp.isfinite(distance), distance, 0.0))

    assert np.asarray(uncompiled(jax.grad(met))(jnp.zeros(1))).tolist() == [0.0]
