"""Tasks in their worlds: rewards by their definitions, ends, and the same episode alone and in a batch."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Key
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.engine import by_llvm
from qrsim.engine.layout import Packer
from qrsim.envs.batch import Batch
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.tasks import Play
from qrsim.tasks.agents import Axis, duration_of, still

Array = np.ndarray[Any, Any]
QUICK: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}


@cache
def play(name: str, *overrides: str) -> Play:
    scenario = load_scenario(name, overrides)
    return Play(scenario.task(), scenario.world(), scenario.steps)


@cache
def programs() -> tuple[Callable[..., Any], Callable[..., Any]]:
    def reset(game: Play, keys: Any) -> Any:
        return jax.vmap(game.reset)(keys)

    def step(game: Play, episode: Any, action: Any) -> Any:
        return jax.vmap(game.step)(episode, action)

    return jax.jit(reset, compiler_options=QUICK), jax.jit(step, compiler_options=QUICK)


def begin(game: Play, seeds: list[int]) -> tuple[Any, Any]:
    keys = game.keys(Key.roots(np.array(seeds), np.zeros(len(seeds), np.int64)))
    found: tuple[Any, Any] = programs()[0](game, keys)
    return found


def steer(game: Play, episode: Any, action: Any) -> tuple[Any, Any]:
    rows = len(np.asarray(episode.step))
    whole = jnp.broadcast_to(jnp.asarray(action, jnp.float32), (rows, len(game.agents), len(game.task.axes)))
    found: tuple[Any, Any] = programs()[1](game, episode, whole)
    return found


def moved(episode: Any, fleet: int, positions: Any) -> Any:
    """Put all vehicles of a fleet somewhere, at rest, in every world."""
    state = episode.state
    vehicle = state.fleets[fleet].vehicle
    rest = vehicle.velocity_body.map(jnp.zeros_like)
    place = jnp.broadcast_to(jnp.asarray(positions, jnp.float32), (*vehicle.thrust.shape, 3))
    changed = replace(vehicle, position_ned=Vec3.of(place), velocity_body=rest, rates_body=rest)
    fleets = list(state.fleets)
    fleets[fleet] = replace(fleets[fleet], vehicle=changed)
    return replace(episode, state=replace(state, fleets=tuple(fleets)))


@pytest.mark.long
def test_cats_are_placed_as_published_and_the_mouse_flees_along_the_sum() -> None:
    """And the reward is that of all cats: the reference sums the first only."""
    game = play("cats_and_mouse/1A")
    episode, seen = begin(game, list(range(8)))
    cats, _ = episode.state.fleets
    place = np.asarray(cats.vehicle.position_ned.stack())
    distance = np.linalg.norm(place[..., :2], axis=-1)
    assert ((distance >= 14.0) & (distance <= 20.0)).all()
    np.testing.assert_array_equal(place[..., 2], -10.0)
    apart = np.linalg.norm(place[:, :, None] - place[:, None], axis=-1) + 1e9 * np.eye(3)
    assert apart.min() >= 22.0
    assert len(np.unique(place[..., 0])) == 24
    # The first tick: the set-point of the mouse is 3 m/s along sum d/|d|^2.
    np.testing.assert_allclose(seen[:, :, 4:6], -place[..., :2], atol=1e-5)
    np.testing.assert_allclose(seen[:, 0, 6:8], place[:, 1, :2] - place[:, 0, :2], atol=1e-5)
    after, step = steer(game, episode, np.zeros((1, 3, 2)))
    away = np.sum(-place[..., :2] / distance[..., None] ** 2, axis=1)
    asked = np.stack(
        [
            np.asarray(after.state.fleets[1].setpoint.velocity_north)[:, 0],
            np.asarray(after.state.fleets[1].setpoint.velocity_east)[:, 0],
        ],
        axis=-1,
    )
    expected = 3.0 * away / np.linalg.norm(away, axis=-1, keepdims=True)
    cosine = np.sum(asked * expected, axis=-1) / 9.0
    assert (cosine > 0.95).all(), "a second later the mouse has moved by some metres"
    np.testing.assert_allclose(np.linalg.norm(asked, axis=-1), 3.0, rtol=1e-5)
    np.testing.assert_array_equal(step.reward, 0.0)
    assert not np.asarray(step.terminated).any()
    _, last = steer(game, replace(after, step=jnp.full(8, 999, jnp.int32)), np.zeros((1, 3, 2)))
    assert np.asarray(last.truncated).all()
    true = _two_seconds_later(game, after)
    mouse = np.asarray(true.state.fleets[1].vehicle.position_ned.stack())
    cat = np.asarray(true.state.fleets[0].vehicle.position_ned.stack())
    reach = np.maximum(np.linalg.norm(cat - mouse, axis=-1) - 4.0, 0.0)
    np.testing.assert_allclose(np.asarray(last.reward)[:, 0], -np.sum(reach**2, axis=1), rtol=1e-4)


def _two_seconds_later(game: Play, episode: Any) -> Any:
    return steer(game, replace(episode, step=jnp.full(8, 999, jnp.int32)), np.zeros((1, 3, 2)))[0]


@pytest.mark.long
def test_a_collision_costs_the_penalty_and_ends_the_episode() -> None:
    game = play("cats_and_mouse/1A")
    episode, _ = begin(game, list(range(8)))
    near = moved(episode, 0, [[1.0, 0.0, -10.0], [30.0, 30.0, -10.0], [-30.0, 30.0, -10.0]])
    _, step = steer(game, near, np.zeros((1, 3, 2)))
    np.testing.assert_array_equal(step.reward, -1000.0)
    assert np.asarray(step.terminated).all()
    assert not np.asarray(step.truncated).any()
    assert np.isfinite(np.asarray(step.observation)).all(), "the last believed place is seen"


@pytest.mark.long
def test_hovering_near_a_person_finds_it_and_gives_one() -> None:
    game = play("search_and_rescue/2A")
    episode, seen = begin(game, [4, 5])
    assert seen["ratio"].shape == (2, 1, 68, 90)
    np.testing.assert_array_equal(seen["grid"], [[[38, 51]]] * 2)
    yaw = np.asarray(episode.state.fleets[0].vehicle.attitude.yaw)
    assert ((yaw >= 0.0) & (yaw < np.pi)).all()
    persons = episode.state.contents.persons
    near = np.stack([[[persons.north[i, 0] + 2.0, persons.east[i, 0], -3.0]] for i in range(2)])
    after, step = steer(game, moved(episode, 0, near), np.zeros((1, 1, 3)))
    np.testing.assert_array_equal(step.reward, [[1.0], [1.0]])
    assert (np.asarray(after.state.contents.persons.found_tick)[:, 0] == 50).all()
    _, step = steer(game, after, np.zeros((1, 1, 3)))
    np.testing.assert_allclose(step.reward, -1.0 / 200.0)


@pytest.mark.long
def test_an_episode_is_the_same_alone_and_in_a_batch() -> None:
    """The noise to the bit, the flight within rounding; where sensors are due at other times than actions too."""
    game = play("plume_mapping/3E", "world.plume.gap=0.4", "world.plume.puffs=1500")
    rows = {}
    for seeds in ([7], [3, 7, 11, 12]):
        episode, _ = begin(game, seeds)
        for _ in range(2):
            episode, step = steer(game, episode, np.zeros((1, len(game.agents), len(game.task.axes))))
        row = seeds.index(7)
        rows[len(seeds)] = jax.tree.map(lambda leaf, row=row: np.asarray(leaf)[row], (episode, step))
    alone, batch = rows[1], rows[4]
    barometer = [fleet.sensors[1].drift for fleet in (alone[0].state.fleets[0], batch[0].state.fleets[0])]
    np.testing.assert_array_equal(*barometer)
    for one, other in zip(jax.tree.leaves(alone[1]), jax.tree.leaves(batch[1]), strict=True):
        np.testing.assert_allclose(one, other, rtol=2e-4, atol=2e-4)


@pytest.mark.nightly
def test_the_noise_of_worlds_at_different_ticks_is_the_same_bits_alone_and_in_a_batch_of_1024() -> None:
    fleet = play("keep_spot").world.fleets[0]

    def draw(seed: Any, tick: Any) -> Any:
        keys = Key.root(jnp.stack([seed, jnp.uint32(0)])).streams(fleet.stream_names)
        ids = jnp.arange(fleet.size, dtype=jnp.uint32)
        return [keys.stream(i, ids).normals(tick, 3, jnp.float32) for i in range(len(fleet.stream_names))]

    seeds, ticks = jnp.arange(1024, dtype=jnp.uint32), 37 * jnp.arange(1024, dtype=jnp.int32)
    batch = jax.jit(jax.vmap(draw))(seeds, ticks)
    alone = jax.jit(draw)
    for row in (0, 5, 1023):
        for one, many in zip(jax.tree.leaves(alone(seeds[row], ticks[row])), jax.tree.leaves(batch), strict=True):
            np.testing.assert_array_equal(one, many[row])


@pytest.mark.long
def test_a_step_of_several_ticks_is_those_ticks_of_a_simulation() -> None:
    """Slow sensors and puffs are due at their own times although a batch counts its ticks together."""
    game = play("plume_mapping/3E", "world.plume.gap=0.4", "world.plume.puffs=1500")
    assert game.in_step
    episode, _ = begin(game, [5])
    for _ in range(3):
        episode, _ = steer(game, episode, np.zeros((1, 1, 3)))
    simulation = Simulation(game.world, seed=5)
    simulation.reset()
    simulation.step(ticks=150)
    mine, theirs = simulation.state, episode.state
    np.testing.assert_array_equal(mine.contents.plume.released, np.asarray(theirs.contents.plume.released)[0])
    assert mine.contents.plume.released[0] > 2
    for part in ("readings", "sensors"):
        parts = (getattr(state.fleets[0], part) for state in (mine, theirs))
        for one, two in zip(*(jax.tree.leaves(tree) for tree in parts), strict=True):
            np.testing.assert_allclose(one, np.asarray(two)[0], rtol=1e-3, atol=2e-3)


def test_a_throttle_of_zero_is_that_of_hover() -> None:
    """Linear from there to both ends; and what is 0 for a number at an end of its range has one side only."""
    game = play("keep_spot")
    asked = np.array([-1.0, -0.5, 0.0, 0.5, 1.0], np.float32)
    flown = [game.scaled(np.array([[0.0, 0.0, throttle, 0.5, 1.0]], np.float32))[0] for throttle in asked]
    np.testing.assert_allclose([row[2] for row in flown], [0.0, 0.295, 0.59, 0.795, 1.0], rtol=1e-6)
    np.testing.assert_allclose([row[3] for row in flown], 2.25, rtol=1e-6)
    np.testing.assert_allclose(game.axes[2].action(np.array([row[2] for row in flown])), asked, atol=1e-6)
    np.testing.assert_array_equal(
        Axis("lift", "1", 0.0, 1.0, 0.0).action(np.array([-1.0, 0.0, 0.25])), [0.0, 0.0, 0.25]
    )
    np.testing.assert_allclose(still(game.axes), [0.0, 0.0, 0.0, 0.0, 1.0])


@pytest.mark.long
def test_the_cost_of_keeping_a_spot_is_as_defined() -> None:
    game = play("keep_spot")
    episode, _ = begin(game, [1])
    action = np.array([[[0.5, -0.25, 0.4, 0.5, 1.0]]])
    after, step = steer(game, episode, action)
    flown = after.state.fleets[0].command
    np.testing.assert_allclose(
        [float(np.asarray(part)[0, 0]) for part in jax.tree.leaves(flown)], [0.45, -0.225, 0.754, 2.25, 12.0], rtol=1e-6
    )
    effort = (2.0 / np.pi) ** 2 * (0.45**2 + 0.225**2) + (0.5 * (0.754 - 0.59)) ** 2 + 2.25**2
    place = np.asarray(after.state.fleets[0].vehicle.position_ned.stack())[0, 0]
    # On the way to the nearest limit, 10 m away, half of what a crash costs is paid too: 0.5 1859.615 (d/10)^2.
    expected = -effort * 0.02 - (1.0 + 9.298) * np.sum((place - [0.0, 0.0, -10.0]) ** 2)
    np.testing.assert_allclose(np.asarray(step.reward)[0, 0], expected, rtol=1e-5)


def test_the_length_of_an_episode_is_a_number_of_its_program() -> None:
    short, longer = (cast(play("keep_spot", f"duration={seconds}"), np.dtype("float32")) for seconds in (0.04, 0.3))
    assert Packer(short) == Packer(longer)
    assert (short.steps, longer.steps) == (2, 15)
    # In single precision 15 times 0.02 is 0.29999998, which would change rewards.
    of_single = duration_of(longer.length, longer.task.period, jnp.zeros(()))
    assert float(of_single) == float(np.float32(0.3))


@pytest.mark.long
def test_another_duration_ends_later_in_the_same_program(monkeypatch: pytest.MonkeyPatch) -> None:
    short = Batch("keep_spot", 1, ["duration=0.2"])
    monkeypatch.setattr(by_llvm, "_loaded", lambda *given: pytest.fail("another duration is another program"))
    longer = Batch("keep_spot", 1, ["duration=0.22"])
    for batch, steps in ((short, 10), (longer, 11)):
        batch.again(np.zeros(1, int))
        ends = [bool(batch.step(np.zeros((1, 1, batch.width)))[2][0]) for _ in range(steps)]
        assert ends == [False] * (steps - 1) + [True]


@pytest.mark.parametrize(
    ("name", "override", "message"),
    [
        ("search_and_rescue/2A", "world.persons=none", "world.persons: there is none, and the task 'search'"),
        ("search_and_rescue/2A", "world.persons.fewest=0", "world.persons.fewest: 0 is out of range"),
        ("search_and_rescue/2A", "task.camera=gnss", "'gnss' is a sensor of type 'ideal_gnss'; allowed: camera"),
        ("plume_mapping/3B", "world.wind=calm", "'dispersion' needs a wind with a speed_20ft above 0; .* is 'calm'"),
        ("plume_mapping/3E", "world.plume.puffs=50", "world.plume.puffs: 50; allowed: at least"),
        ("cats_and_mouse/1A", "task.fleet=cast", "no fleet is called 'cast'; did you mean 'cats'"),
        (
            "cats_and_mouse/1A",
            "fleets.cats.placement.apart=40",
            "3 vehicles at least 40 m apart do not fit within 20 m",
        ),
        ("cats_and_mouse/1C", "ranges.0.path=world.wind.sped_20ft", "no such number; did you mean 'speed_20ft'"),
        ("cats_and_mouse/1C", "ranges.0.high=1000", "ranges.0.high: world.wind.wind_from_rad: .* is out of range"),
        ("cats_and_mouse/1C", "ranges.0.path=task.period", "task.period cannot be drawn; allowed"),
        ("cats_and_mouse/1C", "ranges.0.path=fleets.cats.sensors.gnss.period", "it is compiled into the program"),
    ],
)
def test_what_cannot_be_played_is_refused(name: str, override: str, message: str) -> None:
    from qrsim.errors import ScenarioError

    with pytest.raises(ScenarioError, match=message):
        load_scenario(name, [override])


@pytest.mark.long
def test_cats_that_find_no_place_are_an_error_with_numbers() -> None:
    import qrsim
    from qrsim.errors import RunError

    simulation = qrsim.load("cats_and_mouse/1A", seed=0, overrides=["fleets.cats.placement.tries=1"])
    with pytest.raises(RunError, match="no place for 3 vehicles at least 22 m apart in 1 tries"):
        simulation.reset()


@pytest.mark.long
def test_cats_find_a_place_in_an_episode_that_takes_more_than_a_hundred_tries() -> None:
    """One of 48 000 that were looked at: a learner flies as many, and must not end there."""
    from qrsim.errors import RunError

    few, batch = (Batch("cats_and_mouse/1C", 1, given) for given in (["fleets.cats.placement.tries=100"], []))
    for each in (few, batch):
        each.seeds[:], each.numbers[:] = 10_000_001, 695
    with pytest.raises(RunError, match="in 100 tries"):
        few.again(np.zeros(1, int))
    batch.again(np.zeros(1, int))
    cats = batch.state(0).reshape(-1)[:-1].reshape(-1, 13)[:3, :2]
    apart = np.linalg.norm(cats[:, None] - cats[None], axis=2)[np.triu_indices(3, 1)]
    assert apart.min() >= 22.0


def test_every_episode_draws_the_ranges_anew() -> None:
    """The bearing of the wind, and that of the gusts, which is taken from it."""
    game = play("cats_and_mouse/1C")
    assert game.world.ranges[0].paths == (("wind", "wind_from_rad"), ("turbulence", "wind_from_rad"))
    keys = game.keys(Key.roots(np.arange(300), np.zeros(300, np.int64)))
    from qrsim.world.episode import draw_ranges, episode_draws

    def drawn(key: Any) -> Any:
        return draw_ranges(game.world, episode_draws(game.world, key.world, jnp.zeros((), jnp.float32)))[0]

    bearings = np.asarray(jax.jit(jax.vmap(drawn))(keys))
    assert 0.0 < bearings.min() < 0.1
    assert 6.2 < bearings.max() < 2.0 * np.pi
    world = game.world.with_drawn((jnp.float32(1.25),))
    assert float(world.wind.wind_from_rad) == float(world.turbulence.wind_from_rad) == 1.25
