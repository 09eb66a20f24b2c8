"""The agents of one fleet in a task that has agents of several, as a batch of a task with that fleet alone.

All other agents are flown by the task's baseline, or those of one fleet by a policy file.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.envs.batch import Batch
from qrsim.errors import UsageError
from qrsim.tasks.baselines.many import Many
from qrsim.tasks.learned import LIMIT, PolicyFile, forward
from qrsim.tasks.teams import side_of_fleet


class OneSide:
    """B episodes as the agents of one fleet live them, with what ``Flights`` and objectives need of a ``Batch``.

    Args:
        batch: of a task with agents of several fleets.
        fleet: name of the one that is seen from outside.
        others: of one other fleet; None: the task's baseline flies all others.

    Attributes:
        functional, size: of the batch.
        agents: names of the fleet's agents.

    Raises:
        UsageError: the task has no baseline.
    """

    def __init__(self, batch: Batch, fleet: str, others: Others | None = None):
        self._batch, self._side = batch, side_of_fleet(batch.functional.play.sides, fleet)
        self.functional, self.size, self.agents = batch.functional, batch.size, self._side.names
        self._many, self._others = Many(batch.functional.play, batch.size), others
        self._given: dict[str, Floats] | None = None

    @property
    def seen(self) -> Floats:
        """Observations (B, n, O) of the fleet's agents now."""
        found: Floats = self._batch.seen[self._side.fleet]
        return found

    @property
    def truth(self) -> dict[str, Floats]:
        """Truth of the fleet's agents, by name, (B, n, ...)."""
        return {name: part[:, self._side.rows] for name, part in self._batch.truth.items()}

    def reset(self, seeds: Iterable[object]) -> None:
        """Reset all episodes with new seeds, one each."""
        self._batch.reset(seeds)
        self._begin()

    def again(self, rows: Floats) -> None:
        """Start the next episode in environments number ``rows``, each from the series of its seed."""
        self._batch.again(rows)
        self._begin(rows)

    def _begin(self, rows: Floats | None = None) -> None:
        """Let the others begin episodes."""
        self._many.begin(rows)
        self._given = None
        if self._others is not None:
            self._others.begin(rows)

    def baseline(self) -> Floats:
        """Return the actions (B, n, A) of the task's baseline for the fleet's agents now."""
        found: Floats = self._by_baseline()[self._side.fleet]
        return found

    def _by_baseline(self) -> dict[str, Floats]:
        """Return the baseline's actions by fleet, computed once a step."""
        if self._given is None:
            self._given = self._many.act(self._batch.seen)
        return self._given

    def step(self, action: Floats) -> tuple[Floats, Floats, Floats]:
        """Advance all episodes by the fleet's actions (B, n, A); return reward (B, n) and both ends (B,)."""
        given, self._given = dict(self._by_baseline()), None
        if self._others is not None:
            given[self._others.fleet] = self._others.act(self._batch.seen[self._others.fleet])
        given[self._side.fleet] = action
        sides = self._batch.sides
        parts = [np.pad(given[side.fleet], ((0, 0), (0, 0), (0, self._batch.width - len(side.axes)))) for side in sides]
        reward, terminated, truncated = self._batch.step(np.concatenate(parts, axis=1))
        return reward[:, self._side.rows], terminated, truncated


class Others:
    """A policy file that flies the agents of one fleet in B episodes.

    Args:
        file: the policy, of a task whose agents see and command the same.
        batch: of a task with agents of several fleets.
        learner: the fleet that learns.

    Raises:
        UsageError: no other fleet observes and commands what the policy does.
    """

    def __init__(self, file: PolicyFile, batch: Batch, learner: str):
        play = batch.functional.play
        names = [side.fleet for side in play.sides if side.fleet != learner]
        self.fleet = file.view.fleet if file.view.fleet is not None else names[0]
        if self.fleet == learner:
            raise UsageError(f"--others {file.name}: it flies fleet '{learner}', which learns")
        side_of_fleet(play.sides, self.fleet)
        file.check(play, self.fleet)
        self._file, self._agents = file, len(side_of_fleet(play.sides, self.fleet).names)
        self._last = np.zeros((batch.size, self._agents, file.view.remembered), np.float32)

    def begin(self, rows: Floats | None = None) -> None:
        """Begin all episodes, or the next ones in some rows."""
        self._last[slice(None) if rows is None else rows] = 0.0

    def act(self, seen: Floats) -> Floats:
        """Return the actions (B, n, A) for observations (B, n, O)."""
        view, shape = self._file.view, seen.shape[:2]
        rows = seen.reshape(-1, seen.shape[-1])
        last = self._last.reshape(len(rows), -1)
        outputs = forward(self._file.layers, self._file.scaling.scaled(view.features(rows, last)))
        self._last = view.remember(outputs, rows, last).reshape(self._last.shape)
        found: Floats = view.action(outputs.clip(-LIMIT, LIMIT), rows).reshape(*shape, -1)
        return found
