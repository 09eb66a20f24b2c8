"""What is pickled or deep-copied goes on as the original does, to the bit, in this process and in another."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.small_worlds import noisy_pair, simulate

import qrsim
from qrsim import errors
from qrsim.errors import QrsimError, RunError, ScenarioError
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.pilot import Pilot
from qrsim.simulation.simulation import Simulation

COPIES: list[Callable[[Any], Any]] = [lambda item: pickle.loads(pickle.dumps(item)), copy.deepcopy]
ERRORS = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, QrsimError)]
copied = pytest.mark.parametrize("copy_of", COPIES, ids=["pickle", "deepcopy"])


def flown(ticks: int = 7) -> Simulation:
    """Two vehicles in wind and gusts, some ticks after the start."""
    simulation = Simulation(noisy_pair().world(), seed=11, number=2, name="pair")
    simulation.reset()
    if ticks:
        simulation.step(ticks=ticks)
    return simulation


def ten_more(simulation: Simulation) -> bytes:
    simulation.step(ticks=10)
    return simulation.save()


class TestErrors:
    @copied
    @pytest.mark.parametrize("kind", ERRORS)
    def test_every_error_comes_back_as_it_was(self, kind: type[QrsimError], copy_of: Any) -> None:
        error = kind("a.yaml", ["one", "two"]) if kind is ScenarioError else kind("one")
        error.add_note("seen on Monday")
        found = copy_of(error)
        assert type(found) is kind
        assert (str(found), found.__notes__, found.exit_code) == (str(error), ["seen on Monday"], error.exit_code)

    @pytest.mark.long
    def test_a_pool_delivers_the_faults_of_a_scenario(self) -> None:
        """It used to hang for ever."""
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            asked = pool.apply_async(load_scenario, ({"name": "x", "durations": 1},))
            with pytest.raises(ScenarioError, match="durations") as found:
                asked.get(timeout=120)
        assert found.value.source == "scenario"
        assert any("durations" in problem for problem in found.value.problems)


class TestScenario:
    @copied
    def test_scenarios(self, copy_of: Any) -> None:
        for name in ("patrol_plain", "cats_and_mouse/1C", "plume_mapping/3F", "search_and_rescue/2D"):
            scenario = load_scenario(name)
            found = copy_of(scenario)
            assert found == scenario
            assert found.to_yaml() == scenario.to_yaml()


class TestSimulation:
    @copied
    def test_before_the_start(self, copy_of: Any) -> None:
        found = copy_of(Simulation(noisy_pair().world(), seed=11, number=2, name="pair"))
        assert (found.tick, found.seed, found.number, found.name) == (0, 11, 2, "pair")
        with pytest.raises(errors.UsageError, match="call reset"):
            found.step()
        found.reset()
        assert found.save() == flown(0).save()

    @copied
    @pytest.mark.parametrize("ticks", [0, 7])
    def test_after_the_start(self, copy_of: Any, ticks: int) -> None:
        original = flown(ticks)
        found = copy_of(original)
        assert found.tick == ticks
        assert np.array_equal(found.truth.state, original.truth.state)
        after = ten_more(found)
        # The original has not moved.
        assert original.tick == ticks
        assert after == ten_more(original)

    @pytest.mark.long
    def test_in_another_process(self) -> None:
        original = flown()
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            found = pool.apply_async(ten_more, (original,)).get(timeout=240)
        assert found == ten_more(original)

    @copied
    def test_what_it_says(self, copy_of: Any) -> None:
        simulation = flown()
        reading, truth = copy_of(simulation.reading), copy_of(simulation.truth)
        fleet = reading.fleets[0]
        expected = simulation.reading[fleet]
        simulation.step()
        for sensor in expected.sensors:
            mine, own = getattr(reading[fleet], sensor), getattr(expected, sensor)
            alone = copy_of(own)
            for field in own.fields:
                assert np.array_equal(getattr(mine, field), getattr(own, field), equal_nan=True)
                assert np.array_equal(getattr(alone, field), getattr(own, field), equal_nan=True)
            assert mine.reasons == own.reasons == alone.reasons
        assert not np.array_equal(truth.state, simulation.truth.state)


class Hover:
    """A policy with a memory: it counts how often it was asked."""

    def init(self, reading: Any) -> Any:
        return np.zeros((), np.float32)

    def step(self, reading: Any, memory: Any) -> Any:
        lift = 0.55 + 0.01 * memory
        row = np.array([0.0, 0.0, 1.0, 0.0, 0.0], np.float32)[None] * lift
        return row + np.array([[0.0, 0.0, 0.0, 0.0, 12.0]] * 2, np.float32), memory + 1


def hover(reading: Any) -> Any:
    """A policy that is a function."""
    return [[0.0, 0.0, 0.59, 0.0, 12.0]] * 2


class TestPilot:
    @copied
    @pytest.mark.parametrize("policy", [hover, Hover()], ids=["function", "object"])
    def test_goes_on(self, copy_of: Any, policy: Any) -> None:
        pilot = Pilot(flown(0), policy, policy_ticks=2)
        for _ in range(3):
            pilot.record(5)
        found = copy_of(pilot)
        for each in (pilot, found):
            for _ in range(3):
                each.record(5)
        assert found.simulation is not pilot.simulation
        assert found.simulation.tick == pilot.simulation.tick > 9
        assert found.simulation.save() == pilot.simulation.save()


def test_run_error_in_a_pool_keeps_its_text() -> None:
    assert str(pickle.loads(pickle.dumps(RunError("disk full")))) == "disk full"


@pytest.mark.long
def test_a_simulation_that_xla_flies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("QRSIM_COMPILER", "xla")
    original = simulate({**load_scenario("hover_ideal").spec.model_dump(), "name": "hover"}, seed=3)
    original.step(ticks=3)
    found = pickle.loads(pickle.dumps(original))
    assert ten_more(found) == ten_more(original)
    assert qrsim.Simulation is type(found)
