"""A policy of one fleet, next to the baseline of the others."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from qrsim.core.arrays import Floats
from qrsim.tasks.baselines import baseline
from qrsim.tasks.play import Play
from qrsim.tasks.teams import side_of_fleet


class OneOfSeveral:
    """Flies the agents of one fleet by a policy, and those of the others by the task's baseline.

    Args:
        make: makes the policy of (number of agents, period of the task [s]).
        fleet: name of the policy's fleet.
        play: a task with agents of several fleets.
        seed: of the baseline.

    Raises:
        UsageError: the task has no baseline.
    """

    def __init__(self, make: Callable[[int, float], Any], fleet: str, play: Play, seed: int):
        self._others, self._fleet = baseline(play, seed), fleet
        self._pilot = make(len(side_of_fleet(play.sides, fleet).names), play.task.period)

    def act(self, seen: dict[str, Floats]) -> dict[str, Floats]:
        """Return fleet -> actions (n_f, A) for observations by fleet (n_f, O)."""
        return {**self._others.act(seen), self._fleet: self._pilot.act(seen[self._fleet])}
