"""The mapper against plumes that are made up here.

By the formulas of docs/explanation/models/scene.md written down once more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.scenarios.scenario import load_scenario
from qrsim.tasks import Play
from qrsim.tasks.baselines import Mapping
from qrsim.tasks.baselines.particles import Particles
from qrsim.tasks.baselines.tubes import WindPlume
from qrsim.tasks.plume_mapping import divergence

Array = np.ndarray[Any, Any]
LOW, HIGH = np.array([-140.0, -140.0, -80.0]), np.array([140.0, 140.0, 0.0])
# Sources (S, 3) with rates, and where the wind blows to [rad].
SOURCES, RATES, BEARING = np.array([[-60.0, -20.0, -30.0], [10.0, 70.0, -50.0]]), np.array([1.0, 2.0]), 0.4


def play(name: str, overrides: Iterable[str] = ()) -> Play:
    scenario = load_scenario(f"plume_mapping/{name}", overrides)
    return Play(scenario.task(), scenario.world(), scenario.steps)


def offsets(points: Array, source: Array) -> tuple[Array, Array, Array]:
    """Return how far downwind and across, and the spread."""
    north, east = points[:, 0] - source[0], points[:, 1] - source[1]
    along = np.cos(BEARING) * north + np.sin(BEARING) * east
    return along, np.cos(BEARING) * east - np.sin(BEARING) * north, 2.0 * 0.33 * np.maximum(along, 1e-3) ** 0.86


def steady(points: Array, speed: float, sources: Array = SOURCES, rates: Array = RATES) -> Array:
    """Return the concentration of steady releases."""
    total = np.zeros(len(points))
    for source, rate in zip(sources, rates, strict=True):
        along, across, spread = offsets(points, source)
        level = sum(np.exp(-((points[:, 2] + sign * source[2]) ** 2) / spread) for sign in (-1.0, 1.0))
        total += np.where(along > 0.0, rate / (np.pi * speed * spread) * np.exp(-(across**2) / spread) * level, 0.0)
    return total


def asked(field: Callable[[Array], Array], least: float, count: int, anywhere: int) -> Array:
    """Return locations (count, 3) as the task draws them."""
    numbers = np.random.default_rng(0)
    inside = numbers.uniform(LOW, HIGH, (400_000, 3))
    inside = inside[field(inside) > least]
    assert len(inside) >= count - anywhere
    return np.concatenate([numbers.uniform(LOW, HIGH, (anywhere, 3)), inside[: count - anywhere]])


def flown(mapper: Mapping, locations: Array, smelt: Callable[[Array, int], Array], vehicles: int, steps: int) -> Array:
    """Return the ways (T, n, 3) of points that move as the mapper says, in a wind of 0.5 m/s that it has to learn."""
    place = np.array([[-20.0, 20.0 * i, -10.0] for i in range(vehicles)])
    velocity, ways = np.zeros_like(place), []
    for step in range(steps):
        vehicle = np.concatenate([place, velocity, np.zeros((vehicles, 3)), smelt(place, step)[:, None]], axis=1)
        action = mapper.act({"vehicle": vehicle, "locations": np.broadcast_to(locations, (vehicles, *locations.shape))})
        assert np.abs(action).max() <= 1.0
        velocity = 3.0 * action + [0.5, 0.0, 0.0]
        place = place + velocity
        ways.append(place)
    return np.stack(ways)


def noisy(field: Callable[[Array], Array]) -> Callable[[Array, int], Array]:
    numbers = np.random.default_rng(1)
    return lambda place, step: field(place) + 0.01 * numbers.normal(size=len(place))


def test_locations_alone_tell_the_wind_and_the_sources() -> None:
    """80 locations in the tubes of two sources: the bearing within 2 degrees, all sources within 25 m downwind, 3 m
    across it; most particles agree that there are two."""
    plume = WindPlume.of(play("3C"))
    told = asked(lambda points: steady(points, plume.speed), 1e-3, 80, 0)
    guess = Particles(plume, 0.01, told, np.random.default_rng(3)).guess
    assert np.mean(guess.there.sum(axis=1) == 2) > 0.6
    assert abs(np.degrees(np.median(guess.bearing) - BEARING)) < 2.0
    for source in SOURCES:
        along, across, _ = offsets(guess.place[guess.there], source)
        nearest = np.abs(across) < 20.0
        assert abs(np.median(along[nearest])) < 25.0
        assert abs(np.median(across[nearest])) < 3.0


def test_the_volume_of_a_tube_is_that_of_the_places_in_it() -> None:
    """Against places at random, for a tube in the middle and one that the box cuts at its side and at the ground."""
    plume = WindPlume.of(play("3C"))
    places = np.random.default_rng(0).uniform(LOW, HIGH, (400_000, 3))
    for source in ([-60.0, -20.0, -40.0], [-100.0, 112.0, -60.0]):
        part = np.mean(steady(places, plume.speed, np.array([source]), np.ones(1)) > 2e-4)
        found = plume.volume(np.array([source], np.float32), np.array([BEARING]), np.array([2e-4]))[0]
        assert found == pytest.approx(part * np.prod(HIGH - LOW), rel=0.1)


def test_a_gaussian_is_mapped_by_flying_to_it() -> None:
    """After 200 steps squared errors are a thousandth of those of one who says nothing."""
    mapper = Mapping(play("3A"), seed=1)
    middle, std = np.array([30.0, -40.0, -30.0]), np.array([14.0, 6.0, 9.0])

    def field(points: Array) -> Array:
        return np.asarray(np.exp(-0.5 * np.sum(((points - middle) / std) ** 2, axis=-1)))

    locations = asked(field, 1e-3, 100, 20)
    flown(mapper, locations, lambda place, step: field(place), 1, 200)
    answer = mapper.answer()
    assert answer.shape == (1, 100)
    assert np.sum((answer[0] - field(locations)) ** 2) < 1e-3 * np.sum(field(locations) ** 2)


@pytest.mark.long
def test_three_vehicles_map_steady_sources_and_keep_apart() -> None:
    """After 300 steps squared errors are a fifth of those of one who says nothing; nobody came near others or walls."""
    mapper = Mapping(play("3D"), seed=1)
    speed = WindPlume.of(play("3D")).speed

    def field(points: Array) -> Array:
        return steady(points, speed)

    locations = asked(field, 1e-3, 100, 20)
    ways = flown(mapper, locations, noisy(field), 3, 300)
    answer = mapper.answer()
    assert answer.shape == (3, 100)
    assert np.sum((answer[0] - field(locations)) ** 2) < 0.2 * np.sum(field(locations) ** 2)
    assert min(np.linalg.norm(ways[:, i] - ways[:, j], axis=1).min() for i, j in ((0, 1), (0, 2), (1, 2))) > 4.0
    assert (ways > LOW + 4.0).all()
    assert (ways < HIGH - 4.0).all()


def test_where_locations_tell_nothing_measurements_do() -> None:
    """All locations are anywhere; the vehicle begins 20 m from a strong source: better than zeros by a tenth."""
    settings = ["task.anywhere=30", "task.locations=30"]
    source, rate = np.array([[-38.0, -8.0, -11.0]]), np.array([2.5])
    mapper = Mapping(play("3B", settings), seed=2)
    speed = WindPlume.of(play("3B")).speed

    def field(points: Array) -> Array:
        return steady(points, speed, source, rate)

    locations = asked(field, 0.01, 30, 0)
    flown(mapper, locations, noisy(field), 1, 300)
    assert np.sum((mapper.answer()[0] - field(locations)) ** 2) < 0.9 * np.sum(field(locations) ** 2)


def puffs(points: Array, speed: float, count: int) -> Array:
    """Return concentrations (count, P) at moments that are independent: puffs of the first source, one in 5 s."""
    numbers = np.random.default_rng(2)
    along, across, spread = offsets(points, SOURCES[0])
    level = sum(np.exp(-((points[:, 2] + sign * SOURCES[0, 2]) ** 2) / spread) for sign in (-1.0, 1.0))
    unit = np.where(along > 0.0, level * np.exp(-(across**2) / spread) / (np.pi * spread) ** 1.5, 0.0)
    found = np.zeros((count, len(points)))
    for row in found:
        flown_by = speed * numbers.uniform(0.0, 400.0, numbers.poisson(80))
        amount = numbers.uniform(0.1, 2.5, len(flown_by))
        row += unit * (amount[:, None] * np.exp(-((along - flown_by[:, None]) ** 2) / spread)).sum(axis=0)
    return found


@pytest.mark.long
def test_samples_of_puffs_are_like_those_of_the_source() -> None:
    """Who hovers and says as much everywhere is fifty off; the locations alone bring that below 15."""
    game = play("3E", ["task.samples=400"])
    mapper, plume = Mapping(game, seed=1), WindPlume.of(game)
    locations = asked(lambda points: steady(points, plume.speed, SOURCES[:1], np.array([0.5])), 1e-4, 25, 5)
    flown(mapper, locations, lambda place, step: puffs(place, plume.speed, 1)[0], 1, 20)
    answer = mapper.answer()
    assert answer.shape == (1, 25, 400)
    compare = jax.jit(divergence)
    reference = puffs(locations, plume.speed, 400).astype(np.float32)
    blind = np.random.default_rng(0).exponential(0.01, reference.shape).astype(np.float32)
    assert float(compare(reference, blind)) > 50.0
    assert float(compare(reference, answer[0].T)) < 15.0
    again = Mapping(game, seed=1)
    flown(again, locations, lambda place, step: puffs(place, plume.speed, 1)[0], 1, 20)
    np.testing.assert_array_equal(again.answer(), answer)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("3A", ["task.anywhere=100"]),
        ("3A", ["world.plume.most=3", "world.plume.fewest=2"]),
        ("3A", ["world.plume.most=4", "task.locations=5", "task.anywhere=2", "world.plume.std_max=3.0"]),
        ("3C", ["world.plume.rate_min=1.0", "world.plume.rate_max=1.0"]),
        ("3F", ["world.plume.most=2", "world.plume.fewest=2", "task.anywhere=100", "task.samples=20"]),
        ("3C", ["task.locations=3", "task.anywhere=1", "task.threshold=0.1"]),
    ],
)
def test_other_numbers_are_mapped_too(name: str, settings: list[str]) -> None:
    game = play(name, settings)
    mapper = Mapping(game, seed=1)
    locations = np.random.default_rng(0).uniform(LOW, HIGH, (game.task.locations, 3))
    flown(mapper, locations, noisy(lambda points: 0.1 * np.ones(len(points))), 1, 45)
    answer = mapper.answer()
    assert answer.shape == (1, *game.task.answer_shape(game.world))
    assert np.isfinite(answer).all()
    assert (answer >= 0.0).all()
