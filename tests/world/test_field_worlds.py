"""A field in whole worlds: to the bit whoever flies in it, in both compilers, saved, placed, in rollouts and tasks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_seed_test

import qrsim
from qrsim.envs import parallel_env
from qrsim.envs.single import SingleTask
from qrsim.simulation.rollout import rollout
from qrsim.simulation.simulation import Simulation

pytestmark = pytest.mark.long

FIELD = {"type": "dryden_field", "sweep": 0.2}
PLACES = np.random.default_rng(2).uniform(-40.0, 40.0, (100, 3)) * [1.0, 1.0, 0.4] - [0.0, 0.0, 20.0]


def content(places: Any, **more: Any) -> dict[str, Any]:
    """Return a scenario of points that stand at places in a wind of 6 m/s."""
    return {
        "name": "points",
        "duration": 60.0,
        "world": {
            "wind": {"type": "log_shear", "speed_20ft": 6.0, "wind_from_deg": 200.0},
            "turbulence": {**FIELD, **more},
            "collision_distance": 0.0,
        },
        "fleets": {
            "points": {
                "vehicle": {"type": "fixed_point"},
                "controller": {"type": "none"},
                "guidance": {"type": "none"},
                "vehicles": [{"position_ned": [float(x) for x in place]} for place in places],
            }
        },
    }


def flown(places: Any, ticks: int = 60, seed: int = 4, **options: Any) -> Any:
    """Return gusts and rates (n, 6) after some ticks."""
    simulation = Simulation(qrsim.load_scenario(content(places), quiet=True).world(), seed=seed, **options)
    simulation.reset()
    simulation.step(ticks=ticks)
    return air(simulation.state)


def air(state: Any) -> Any:
    fleet = state.fleets[0]
    return np.column_stack([np.asarray(part.stack()) for part in (fleet.gust_ned, fleet.gust_rates_ned)])


def test_a_gust_is_the_same_to_the_bit_whoever_flies() -> None:
    many = flown(PLACES)
    np.testing.assert_array_equal(flown(PLACES[:1]), many[:1])
    np.testing.assert_array_equal(flown(PLACES[7::-1]), many[7::-1])
    assert np.abs(flown(PLACES[:8], seed=5) - many[:8]).max() > 0.3
    # In many worlds side by side, however they are cut.
    world = qrsim.load_scenario(content(PLACES[:8]), quiet=True).world()

    def gusts(state: Any) -> Any:
        return state.fleets[0].gust_ned.stack()

    for worlds in (3, 20):
        found = rollout(world, ticks=60, worlds=worlds, seed=4, record=gusts, record_every=60)
        np.testing.assert_array_equal(found.recorded[0, -1], many[:8, :3])
    np.testing.assert_array_equal(found.recorded[2, -1], flown(PLACES[:8], number=2)[:, :3])
    assert np.abs(found.recorded[2, -1] - many[:8, :3]).max() > 0.3


def test_both_compilers_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    native = flown(PLACES[:8])
    monkeypatch.setenv("QRSIM_COMPILER", "xla")
    np.testing.assert_allclose(flown(PLACES[:8]), native, atol=1e-4)


def test_a_saved_run_goes_on_and_a_placed_vehicle_meets_the_gust_of_its_new_place() -> None:
    simulation = Simulation(qrsim.load_scenario(content(PLACES[:8]), quiet=True).world(), seed=4)
    simulation.reset()
    simulation.step(ticks=25)
    saved = simulation.save()
    simulation.step(ticks=35)
    np.testing.assert_array_equal(air(simulation.state), flown(PLACES[:8]))
    simulation.load(saved)
    simulation.step(ticks=35)
    np.testing.assert_array_equal(air(simulation.state), flown(PLACES[:8]))
    # The first four go where the next four are.
    simulation.load(saved)
    simulation.set_state(np.concatenate([PLACES[4:8], np.full((4, 3), np.nan)]))
    simulation.step(ticks=35)
    np.testing.assert_array_equal(air(simulation.state), flown(np.concatenate([PLACES[4:8], PLACES[4:8]])))


def test_worlds_whose_wind_is_drawn_have_fields_that_move_with_it() -> None:
    """Frequencies go with the speed of the wind, and nothing else of the field is another one."""
    base = content(PLACES[:1], sweep=0.0)

    def drawn(more: dict[str, Any]) -> Any:
        world = qrsim.load_scenario({**base, **more}, quiet=True).world()
        found = rollout(world, ticks=1, worlds=6, seed=4, record=lambda s: (s.drawn, s.field), record_every=1)
        return found.recorded

    _, fixed = drawn({})
    (speeds,), ranged = drawn({"ranges": [{"path": "world.wind.speed_20ft", "low": 2.0, "high": 10.0}]})
    assert np.ptp(speeds) > 1.0
    np.testing.assert_array_equal(ranged.phase, fixed.phase)
    np.testing.assert_array_equal(ranged.dilation, fixed.dilation)
    np.testing.assert_allclose(ranged.frequency, fixed.frequency * (speeds / 6.0)[..., None], rtol=1e-4, atol=1e-8)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_tasks_are_flown_in_it() -> None:
    wind = "world.wind={type: log_shear, speed_20ft: 4, wind_from_deg: 200}"
    check_env(SingleTask("keep_spot", [wind, "world.turbulence=dryden_field"]))
    parallel_seed_test(lambda: parallel_env("cats_and_mouse/1C", overrides=["world.turbulence=dryden_field"]))
