"""Learns a task by the PPO of Stable-Baselines3 with its defaults: ``python _ppo.py SETTINGS``, JSON, for _learners.py.

Every agent of an episode is one environment of the learner, so that agents of a team share a policy. It prints a line
for every try, and at the end one with the scores.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import gymnasium
import jax
import numpy as np

from evidence._learners import NEW, TRIED
from evidence.returns import fly
from qrsim.envs import gymnasium_id, learner_id
from qrsim.envs.batch import Batch
from qrsim.envs.learner import LearnerTask
from qrsim.envs.objective import objective_of
from qrsim.envs.spaces import action_space
from qrsim.envs.viewing import batch_of
from qrsim.studies.learn.flights import Flights

# Seeds of the episodes to learn from where agents share a policy, far from those of the scores.
LEARNED = 10**7


def shared(name: str, episodes: int, seed: int, scale: float) -> Any:
    """Return the agents of many episodes as a vector environment of Stable-Baselines3."""
    from stable_baselines3.common.vec_env import VecEnv

    class Agents(VecEnv):  # type: ignore[misc]
        """Each agent of each episode."""

        def __init__(self) -> None:
            self.batch = Batch(name, episodes)
            self.agents = len(self.batch.functional.agents)
            self.batch.reset(LEARNED + episodes * seed + np.arange(episodes))
            self.render_mode = None
            seen = gymnasium.spaces.Box(-np.inf, np.inf, self.batch.seen.shape[2:], np.float32)
            super().__init__(episodes * self.agents, seen, action_space(self.batch))

        def reset(self) -> Any:
            """Begin, once."""
            return self.seen()

        def seen(self) -> Any:
            """Return what each sees."""
            return self.batch.seen.reshape(self.num_envs, -1).copy()

        def step_async(self, actions: Any) -> None:
            """Keep actions for ``step_wait``."""
            self.actions = actions.reshape(episodes, self.agents, -1)

        def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
            """Advance, and begin the next episodes where one has ended."""
            reward, terminated, truncated = self.batch.step(self.actions)
            ended, last = np.repeat(terminated | truncated, self.agents), self.seen()
            told: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
            for i in np.flatnonzero(ended):
                cut = bool(truncated[i // self.agents] and not terminated[i // self.agents])
                told[i] = {"terminal_observation": last[i], "TimeLimit.truncated": cut}
            if ended.any():
                self.batch.again(np.flatnonzero(terminated | truncated))
            return self.seen(), scale * reward.reshape(-1).astype(np.float32), ended, told

        def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
            """Return what all have in common."""
            return [getattr(self, attr_name, None) for _ in self._get_indices(indices)]

        def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
            """Do nothing."""

        def env_method(self, method_name: str, *args: Any, indices: Any = None, **options: Any) -> list[Any]:
            """Do nothing."""
            return []

        def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
            """Return that none is."""
            return [False for _ in self._get_indices(indices)]

        def close(self) -> None:
            """Do nothing."""

    return Agents()


def learn(settings: dict[str, Any]) -> dict[str, Any]:
    """Return how a learner does.

    Args:
        settings: the fields of a ``Study``, and the ``seed``.
    """
    from stable_baselines3 import PPO

    name, episodes, seed, scale = (settings[each] for each in ("task", "episodes", "seed", "scale"))
    world: Any
    if episodes:
        world = shared(name, episodes, seed, scale)
    elif settings["learner"]:
        world = gymnasium.make(learner_id(name))
    else:
        world = gymnasium.wrappers.TransformReward(gymnasium.make(gymnasium_id(name)), lambda reward: scale * reward)
    model = PPO("MlpPolicy", world, seed=seed, device="cpu")

    def act(seen: Any) -> Any:
        return model.predict(seen, deterministic=True)[0]

    flown = of_learner if settings["learner"] else of_task
    tried, curve, begun = flown(world, name, settings["tries"]), {}, time.perf_counter()
    while model.num_timesteps < settings["most"]:
        model.learn(settings["between"], reset_num_timesteps=False)
        total, alive = tried(act, TRIED)
        curve[f"step_{model.num_timesteps}"] = {"mean": round(total.mean(), 2), "flown_to_the_end": alive.mean()}
        say({"step": model.num_timesteps, **curve[f"step_{model.num_timesteps}"]})
        if settings["until_whole"] and alive.all():
            break
    took = round(time.perf_counter() - begun, 1)
    total, alive = flown(world, name, settings["trials"])(act, NEW)
    return {
        "steps": model.num_timesteps,
        "seconds": took,
        "curve": curve,
        "returns": total.tolist(),
        "alive": alive.tolist(),
    }


def of_task(_: Any, name: str, episodes: int) -> Any:
    """Return a function that flies the seeds from one on by actions, and returns what ``fly`` does."""
    batch = Batch(name, episodes)

    def flown(act: Any, seed: int) -> Any:
        def flat(_: int, seen: Any) -> Any:
            return act(seen.reshape(-1, seen.shape[-1])).reshape(*seen.shape[:2], -1)

        return fly(batch, flat, seed)

    return flown


def of_learner(world: Any, name: str, episodes: int) -> Any:
    """Return the same for a policy that sees and acts as in the form for learners."""
    form: LearnerTask = world
    while not isinstance(form, LearnerTask):
        form = form.env
    batch = batch_of(name, episodes, [], form.view)
    flights = Flights(batch, form.view, objective_of(batch, 0.99))

    def flown(act: Any, seed: int) -> Any:
        return flights.fly(lambda features: act(form.scaled(features)).clip(-1.0, 1.0), seed + np.arange(episodes))

    return flown


def say(line: dict[str, Any]) -> None:
    """Print a line."""
    print(json.dumps(jax.tree.map(float, line) if "step" in line else line), flush=True)


if __name__ == "__main__":
    say(learn(json.loads(sys.argv[1])))
