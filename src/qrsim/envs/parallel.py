"""A task of several vehicles as a parallel environment of PettingZoo."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from qrsim.core.arrays import NumpyArray
from qrsim.envs.arguments import checked_arguments
from qrsim.envs.batch import STATE, Batch
from qrsim.envs.drawing import RENDER_MODES, Drawing, checked_mode
from qrsim.envs.single import shaped
from qrsim.envs.spaces import Space, action_space, answer_space, observation_space, split_say
from qrsim.errors import UsageError, did_you_mean
from qrsim.files import Content


class ParallelTask(ParallelEnv):  # type: ignore[misc]
    """A task whose agents are the vehicles of a fleet, or of several; other fleets are part of the world.

    Agents of several fleets may have actions and observations of their own.

    All agents act at once, and their episode ends for all together: terminated when any vehicle of the world has
    stopped, truncated after the last step. With ``task.leave`` an agent that stops is terminated alone, and leaves
    ``agents``; the episode ends when all have, or a vehicle has stopped that is no agent.

    Args:
        scenario: as ``qrsim.load`` takes it.
        overrides: assignments such as "world.wind.speed_20ft=7".
        precision: "float32" or "float64".
        render_mode: as of ``SingleTask``.

    Attributes:
        observation_axes: as of ``SingleTask``, each of one agent; the axes of several fleets by fleet.
        answer_space: as of ``SingleTask``, each of one agent.
    """

    metadata: dict[str, object] = {"render_modes": list(RENDER_MODES), "name": "qrsim"}  # noqa: RUF012

    @checked_arguments
    def __init__(
        self,
        scenario: str | Path | Content,
        overrides: Iterable[str] = (),
        precision: str = "float32",
        render_mode: str | None = None,
    ):
        self.render_mode = checked_mode(render_mode)
        self.batch = Batch(scenario, 1, overrides, precision)
        self.metadata = {**self.metadata, "name": self.batch.functional.name, "render_fps": self.batch.steps_per_second}
        self._drawing = None if render_mode is None else Drawing(self.batch)
        self.possible_agents = list(self.batch.functional.agents)
        self.agents: list[str] = []
        self.batch.reset(np.zeros(1, np.int64))
        self.answer_space = answer_space(self.batch)
        self.observation_axes = self.batch.functional.observation_axes
        self.action_spaces: dict[str, Space] = {
            agent: action_space(self.batch, i) for i, agent in enumerate(self.possible_agents)
        }
        self.observation_spaces: dict[str, Space] = {
            agent: observation_space(self.batch.functional.play, self.batch.seen, i)
            for i, agent in enumerate(self.possible_agents)
        }
        self._seeded = False

    def observation_space(self, agent: str) -> Space:
        """Return the Gymnasium space of this agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Space:
        """Return the Gymnasium space of this agent's actions."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, object] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start an episode, without a seed the next of the series; return observations and infos by agent.

        Options are those of ``SingleTask``.

        Raises:
            UsageError: a seed is no integer from 0 to 2**63 - 1, or a difficulty is none.
        """
        self.batch.take_options(options)
        if seed is None and self._seeded:
            self.batch.again(np.zeros(1, np.int64))
        else:
            first = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
            self.batch.reset([first])
        self._seeded = True
        self.agents = list(self.possible_agents)
        if self._drawing is not None:
            self._drawing.begin()
        return self._observations(), self._truths()

    def step(
        self, actions: Mapping[str, object]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Advance by one step; return observations, rewards, terminated, truncated and infos, each by agent.

        Raises:
            UsageError: the episode has ended, an agent has no action or is unknown, or an action is of another shape,
                not finite, out of range or incomplete.
        """
        if not self.agents:
            raise UsageError("the episode has ended, or has not begun: call reset()")
        flown, said = self._checked(actions)
        rewards, terminated, truncated = self.batch.step(flown[None], said[None])
        totals = rewards[0].astype(float)
        if truncated[0]:
            totals += self.batch.scores(np.zeros(1, int))[0]
        if self._drawing is not None:
            self._drawing.moved()
        ended, over = bool(terminated[0]), bool(truncated[0])
        rows = [self.possible_agents.index(agent) for agent in self.agents]
        left = [ended or (self.batch.gone is not None and bool(self.batch.gone[0, row])) for row in rows]
        seen, truth = self._observations(), self._truths()
        found = (
            {agent: seen[agent] for agent in self.agents},
            {agent: float(totals[row]) for agent, row in zip(self.agents, rows, strict=True)},
            dict(zip(self.agents, left, strict=True)),
            {agent: over and not gone for agent, gone in zip(self.agents, left, strict=True)},
            {agent: truth[agent] for agent in self.agents},
        )
        still = [agent for agent, gone in zip(self.agents, left, strict=True) if not gone]
        self.agents = [] if ended or over else still
        return found

    def _checked(self, actions: object) -> tuple[NumpyArray, NumpyArray]:
        """Return actions (n, A), 0 for agents that have left, and their radio messages (n, D), NaN for none."""
        if not isinstance(actions, dict):
            raise UsageError(f"actions: expected a dict with one for each agent, found {type(actions).__name__}")
        for agent in actions:
            if agent not in self.agents:
                raise UsageError(f"actions: no agent is called '{agent}'{did_you_mean(str(agent), self.agents)}")
        missing = [agent for agent in self.agents if agent not in actions]
        if missing:
            raise UsageError(f"actions: there is none for {', '.join(missing)}")
        count = len(self.possible_agents)
        flown = [np.zeros(self.batch.width, self.batch.dtype)] * count
        said = [np.full(self.batch.functional.play.message, np.nan, self.batch.dtype)] * count
        for agent in self.agents:
            who, row = f"action of {agent}", self.possible_agents.index(agent)
            act, said[row] = split_say(self.batch, actions[agent], who)
            flown[row] = shaped(self.batch, act, who, agent=row)
        return np.stack(flown), np.stack(said)

    def render(self) -> NumpyArray | None:
        """Return a picture of the episode from above, (480, 640, 3) uint8; None without a render mode."""
        return None if self._drawing is None else self._drawing.frame()

    @property
    def state_space(self) -> spaces.Box:
        """Gymnasium space of the true states that ``state`` returns."""
        return spaces.Box(-np.inf, np.inf, (STATE * self.batch.vehicles + 1,), self.batch.dtype.type)

    def state(self) -> NumpyArray:
        """Return the true state (S,) of all vehicles in the episode, for a centralised critic; see ``Batch.state``.

        Raises:
            UsageError: nothing has begun.
        """
        if not self._seeded:
            raise UsageError("nothing has begun: call reset()")
        return self.batch.state(0)

    def hand_in(self, samples: Mapping[str, object]) -> None:
        """Store the agents' answers, by agent, of which the last ones are scored; see ``SingleTask.hand_in``.

        Raises:
            UsageError: there is no such agent, and as of ``SingleTask``.
        """
        if not self.agents:
            raise UsageError("the episode has ended, or has not begun: hand in before its last step")
        for agent, answer in samples.items():
            if agent not in self.possible_agents:
                raise UsageError(
                    f"samples: no agent is called '{agent}'{did_you_mean(str(agent), self.possible_agents)}"
                )
            number = np.array([self.possible_agents.index(agent)])
            self.batch.hand_in([[answer]], np.zeros(1, int), number)

    def set_difficulty(self, difficulty: float) -> None:
        """Set the difficulty of later episodes, from 0 (the scenario's values) to 1 (its full random ranges).

        Raises:
            UsageError: it is no number from 0 to 1, or the scenario has no ranges.
        """
        self.batch.set_difficulty(difficulty)

    def _observations(self) -> dict[str, object]:
        """Return the present observations by agent."""
        return {
            agent: jax.tree.map(lambda leaf: leaf[0], self.batch.of_agent(self.batch.seen, i))
            for i, agent in enumerate(self.possible_agents)
        }

    def _truths(self) -> dict[str, dict[str, object]]:
        """Return the present true values by agent and name."""
        return {
            agent: {name: leaf[0, i].copy() for name, leaf in self.batch.truth.items()}
            for i, agent in enumerate(self.possible_agents)
        }
