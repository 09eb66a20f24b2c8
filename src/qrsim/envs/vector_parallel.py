"""A task of several vehicles, many times: parallel environments of PettingZoo side by side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from gymnasium.vector import AutoresetMode

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.envs.arguments import checked_arguments
from qrsim.envs.batch import Batch
from qrsim.envs.drawing import RENDER_MODES
from qrsim.envs.series import Series
from qrsim.envs.single import shaped
from qrsim.envs.spaces import Space, action_space, answer_space, observation_space, split_say
from qrsim.errors import UsageError, did_you_mean
from qrsim.files import Content

Spaces = dict[str, Space]


class VectorParallelTask:
    """Many episodes of a task of several vehicles, computed as one batch.

    What ``ParallelTask`` has of one episode is here an array of all, by the name of the agent. An episode ends for all
    its agents together; with ``task.leave`` an agent that has stopped stays terminated, at no reward, until then.
    Environment i of a seed s is that of ``ParallelTask`` with the seed s + i.

    Args:
        scenario: as ``qrsim.load`` takes it.
        overrides: assignments such as "world.wind.speed_20ft=7".
        precision: "float32" or "float64".
        render_mode: as of ``SingleTask``.
        num_envs: number of episodes.
        autoreset_mode: as of ``VectorTask``.

    Attributes:
        possible_agents: names of the agents; all act in every step.
        observation_axes: as of ``SingleTask``, each of one agent in one environment.
        answer_space: as of ``SingleTask``, each of one agent in one environment.

    Raises:
        UsageError: there is no such mode.
    """

    metadata: dict[str, object] = {"render_modes": list(RENDER_MODES), "name": "qrsim"}  # noqa: RUF012

    @checked_arguments
    def __init__(
        self,
        scenario: str | Path | Content,
        num_envs: int = 1,
        overrides: Iterable[str] = (),
        precision: str = "float32",
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ):
        self.render_mode = render_mode
        self.batch = Batch(scenario, num_envs, overrides, precision)
        self.num_envs = self.batch.size
        self._series = Series(self.batch, autoreset_mode, render_mode)
        self.metadata = {
            **self.metadata,
            "name": self.batch.functional.name,
            "autoreset_mode": self._series.mode,
            "render_fps": self.batch.steps_per_second,
        }
        self.possible_agents = list(self.batch.functional.agents)
        self.observation_axes, self.answer_space = self.batch.functional.observation_axes, answer_space(self.batch)
        shapes = jax.eval_shape(self.batch.functional.reset, np.zeros(2, np.uint32))[1]
        like = jax.tree.map(lambda leaf: np.broadcast_to(np.zeros((), leaf.dtype), (1, *leaf.shape)), shapes)
        play, numbered = self.batch.functional.play, list(enumerate(self.possible_agents))
        self.observation_spaces: Spaces = {agent: observation_space(play, like, i) for i, agent in numbered}
        self.action_spaces: Spaces = {agent: action_space(self.batch, i) for i, agent in numbered}

    @property
    def agents(self) -> list[str]:
        """Names of the agents that act now: all of them."""
        return list(self.possible_agents)

    def observation_space(self, agent: str) -> Space:
        """Return the Gymnasium space of this agent's observations in one environment."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Space:
        """Return the Gymnasium space of this agent's actions in one environment."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | list[int | None] | None = None, options: dict[str, object] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start all episodes, or those of ``options["reset_mask"]``, as ``VectorTask.reset``; return what agents see.

        Returns:
            By agent what it sees, (num_envs, ...), and what is really the case, by name (num_envs, ...).
        """
        self._series.reset(seed, options)
        return self._seen_by_each(self.batch.seen), self._of_each(self.batch.truth)

    def step(self, actions: Mapping[str, object]) -> tuple[dict[str, Any], ...]:
        """Advance all environments by one step; ended episodes restart as ``autoreset_mode`` says.

        Args:
            actions: by agent, (num_envs, A); with a radio a dict of ``act`` and ``say`` (num_envs, D).

        Returns:
            By agent what it sees, its rewards, whether terminated and truncated, each (num_envs, ...), and infos: what
            is really the case; where episodes have ended in ``SAME_STEP`` also ``final_obs`` and ``final_info``, and in
            ``_final_obs`` and ``_final_info`` (num_envs,) which those are.

        Raises:
            UsageError: as of ``VectorTask.step``, or an agent has no action or is unknown.
        """
        self._series.check_going()
        flown, words = self._checked(actions)
        moved = self._series.step(flown, words)
        infos = self._of_each(self.batch.truth)
        stopped = np.zeros(moved.rewards.shape, bool) if moved.gone is None else moved.gone
        terminated = moved.terminated[:, None] | stopped
        if moved.last is not None:
            last, really = self._seen_by_each(moved.last[0]), self._of_each(moved.last[1])
            for agent, info in infos.items():
                info |= {"final_obs": last[agent], "final_info": really[agent]}
                info |= {"_final_obs": moved.ended.copy(), "_final_info": moved.ended.copy()}
        return (
            self._seen_by_each(self.batch.seen),
            self._of_each(moved.rewards),
            self._of_each(terminated),
            self._of_each(moved.truncated[:, None] & ~terminated),
            infos,
        )

    def hand_in(self, samples: Mapping[str, object], mask: object = None) -> None:
        """Store answers by agent, (num_envs, ...) each, of all environments or those in ``mask``.

        Raises:
            UsageError: as of ``VectorTask.hand_in``, or there is no such agent.
        """
        rows = self._series.rows(mask, "mask")
        for agent, answers in samples.items():
            self._check_agent(agent, "samples")
            array = np.asarray(answers)
            if array.shape[:1] != (self.num_envs,):
                raise UsageError(
                    f"samples of {agent}: expected those of {self.num_envs} environments, found shape {array.shape}"
                )
            self.batch.hand_in(array[rows][:, None], rows, np.array([self.possible_agents.index(agent)]))

    def state(self) -> NumpyArray:
        """Return the true states (num_envs, S) of all vehicles, for a centralised critic; see ``Batch.state``.

        Raises:
            UsageError: nothing has begun.
        """
        if not self.batch.episodes.started:
            raise UsageError("nothing has begun: call reset()")
        return np.stack([self.batch.state(row) for row in range(self.num_envs)])

    def render(self) -> tuple[Floats, ...] | None:
        """Return a picture of each environment from above; None without a render mode."""
        return self._series.frames()

    def set_difficulty(self, difficulty: float) -> None:
        """Set the difficulty of later episodes, from 0 (the scenario's values) to 1 (its full random ranges).

        Raises:
            UsageError: it is no number from 0 to 1, or the scenario has no ranges.
        """
        self.batch.set_difficulty(difficulty)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def _check_agent(self, agent: object, what: str) -> None:
        """Raise UsageError for an unknown agent; ``what``: what was given for it, for the message."""
        if agent not in self.possible_agents:
            raise UsageError(f"{what}: no agent is called '{agent}'{did_you_mean(str(agent), self.possible_agents)}")

    def _checked(self, actions: object) -> tuple[NumpyArray, NumpyArray]:
        """Return actions (num_envs, n, A) and radio messages (num_envs, n, D) of all agents, from those by agent."""
        if not isinstance(actions, dict):
            raise UsageError(f"actions: expected a dict with one for each agent, found {type(actions).__name__}")
        for agent in actions:
            self._check_agent(agent, "actions")
        missing = [agent for agent in self.possible_agents if agent not in actions]
        if missing:
            raise UsageError(f"actions: there is none for {', '.join(missing)}")
        each = []
        for number, agent in enumerate(self.possible_agents):
            who = f"actions of {agent}"
            done, words = split_say(self.batch, actions[agent], who, self.num_envs)
            each.append((shaped(self.batch, done, who, self.num_envs, agent=number), words))
        flown, said = zip(*each, strict=True)
        return np.stack(flown, axis=1), np.stack(said, axis=1)

    def _seen_by_each(self, seen: object) -> dict[str, Any]:
        """Split observations of all agents into agent -> its own (num_envs, ...)."""
        return {agent: self.batch.of_agent(seen, i) for i, agent in enumerate(self.possible_agents)}

    def _of_each(self, tree: object) -> dict[str, Any]:
        """Split arrays (num_envs, n, ...) into agent -> arrays (num_envs, ...)."""
        return {
            agent: jax.tree.map(lambda leaf, i=i: leaf[:, i].copy(), tree)
            for i, agent in enumerate(self.possible_agents)
        }
