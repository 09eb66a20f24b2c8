"""Flies episodes of a task with its baseline, one by one, as ``qrsim run --policy baseline`` does."""

from __future__ import annotations

from collections.abc import Hashable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError
from qrsim.interface.metrics import FLIGHT_METRICS
from qrsim.scenarios.scenario import Scenario
from qrsim.simulation.pilot import Pilot
from qrsim.simulation.simulation import Simulation
from qrsim.studies.sweep.groups import Group
from qrsim.studies.sweep.job import Job, goals
from qrsim.tasks import Play
from qrsim.tasks.baselines import BaselinePolicy, baseline
from qrsim.world.state import State, World


def play(group: Group, job: Job) -> dict[str, NumpyArray]:
    """Fly a batch with the task's baseline policy; return metrics of vehicles (W, n, ...) and of the task (W,).

    Raises:
        UsageError: the scenario has no task, or its task has no baseline.
    """
    episodes = []
    for i, seed in enumerate(job.seeds.tolist()):
        values = {path: numbers[i].item() for path, numbers in job.numbers.items()}
        key = (job.group, job.precision, tuple(values.items()))
        if key not in _KEPT:
            _KEPT.clear()
            _KEPT[key] = _Point(group.scenario(values), job.precision)
        episodes.append(_KEPT[key].episode(seed))
    return {name: np.concatenate([episode[name] for episode in episodes]) for name in episodes[0]}


class _Policy(BaselinePolicy):
    """A baseline that begins anew without being compiled anew."""

    def again(self, seed: int) -> None:
        """Reset the baseline policy for an episode with another seed, without compiling it again."""
        self.seed, self._memory = seed, None
        self._baseline = baseline(self.play, seed)


class _Point:
    """A scenario with its baseline, for one episode after the other."""

    def __init__(self, scenario: Scenario, precision: str):
        if not scenario.steps:
            raise UsageError(f"policy baseline: scenario {scenario.name} has no task")
        self.ticks, self.world = scenario.ticks, scenario.world(precision)
        self.play = Play(scenario.task(precision), self.world, scenario.steps)
        self.simulation = Simulation(self.world, name=scenario.name, site=scenario.site)
        self.policy = _Policy(self.play)

    def episode(self, seed: int) -> dict[str, NumpyArray]:
        """Fly one episode with the baseline policy; return its metrics, each (1, ...), with the goals."""
        simulation, world = self.simulation, self.world
        simulation.reset(seed=seed)
        self.policy.again(seed)
        with simulation.precision_context():
            flight = FLIGHT_METRICS.init(world, simulation.state)
        pilot = Pilot(simulation, self.policy, None, self.play.ticks)
        while simulation.tick < self.ticks:
            history = pilot.record(self.ticks - simulation.tick, capacity=self.play.ticks)
            with simulation.precision_context():
                flight = _summed()(flight, world, history.state, np.asarray(history.ticks, np.int32))
        state = simulation.state
        one, at = jax.tree.map(lambda leaf: np.asarray(leaf)[None], (flight, state))
        found = FLIGHT_METRICS.finish(one, world, at)
        return {**found, **_finds(state, world.time_step), "goal_ned": goals(world)[None]}


# The point flown last, which the next episode most often has too.
_KEPT: dict[Hashable, _Point] = {}


@cache
def _summed() -> Any:
    """Return the compiled program that updates flight metrics with the states of several ticks."""

    def summed(flight: object, world: World, states: object, ticks: object) -> object:
        """Return a flight's metrics after an update with the state of each tick in order."""

        def one(known: Any, at: Any) -> Any:
            """Update the metrics with the state of one tick."""
            state, tick = at
            return FLIGHT_METRICS.update(known, world, state, tick), None

        return jax.lax.scan(one, flight, (states, jnp.asarray(ticks)))[0]

    return jax.jit(summed)


def _finds(state: State, time_step: float) -> dict[str, NumpyArray]:
    """Return the metrics of persons found, (1,) each; NaN in a world without persons."""
    persons = state.contents.persons
    if persons is None:
        return {name: np.full(1, np.nan) for name in ("persons_found", "found_share", "first_found_s")}
    ticks = np.asarray(persons.found_tick)[np.asarray(persons.there)]
    found = ticks[ticks >= 0]
    share = len(found) / len(ticks) if len(ticks) else np.nan
    first = found.min() * time_step if len(found) else np.nan
    return {
        "persons_found": np.array([float(len(found))]),
        "found_share": np.array([share]),
        "first_found_s": np.array([first]),
    }
