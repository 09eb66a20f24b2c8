"""One vehicle's task, many times, for learners of Stable-Baselines3: ``PPO("MlpPolicy", VecTask("keep_spot", 64))``."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from gymnasium.vector import AutoresetMode

from qrsim.core.arrays import NumpyArray
from qrsim.envs.vector import VectorTask
from qrsim.errors import UsageError
from qrsim.files import Content

try:
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError:
    raise UsageError(
        "qrsim.envs.sb3 needs Stable-Baselines3: python -m pip install stable-baselines3 (with torch, which is large)"
    ) from None


class VecTask(VecEnv):  # type: ignore[misc]
    """Many episodes of a task as a vector environment of Stable-Baselines3, computed as one batch.

    An episode that ends is followed by the next in the same step; ``infos[i]`` of that step has
    ``terminal_observation``, ``TimeLimit.truncated``, what was really the case, and ``episode``, from which
    Stable-Baselines3 logs ``ep_rew_mean`` and ``ep_len_mean``. Other infos are empty.

    Args:
        scenario, num_envs, overrides, precision, render_mode: as of ``VectorTask``.

    Raises:
        UsageError: as of ``VectorTask``.
    """

    def __init__(
        self,
        scenario: str | Path | Content,
        num_envs: int = 1,
        overrides: Iterable[str] = (),
        precision: str = "float32",
        render_mode: str | None = None,
    ):
        self.tasks = VectorTask(scenario, num_envs, overrides, precision, render_mode, AutoresetMode.SAME_STEP)
        # SB3 asks every environment for it.
        self.render_mode = render_mode
        super().__init__(num_envs, self.tasks.single_observation_space, self.tasks.single_action_space)
        self._actions: Any = None
        self._returns, self._lengths = np.zeros(num_envs), np.zeros(num_envs, np.int64)
        self._begun = time.monotonic()

    def reset(self) -> Any:
        """Start all episodes, with the seeds of the last ``seed`` call, and return the observations."""
        seeds = self._seeds
        given = None if any(seed is None for seed in seeds) else list(seeds)
        seen, infos = self.tasks.reset(seed=given)
        self.reset_infos = [_row(infos, i) for i in range(self.num_envs)]
        self._returns[:], self._lengths[:] = 0.0, 0
        self._reset_seeds()
        self._reset_options()
        return seen

    def step_async(self, actions: object) -> None:
        """Store the actions (num_envs, A) of the next ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NumpyArray, NumpyArray, list[dict[str, Any]]]:
        """Advance all environments by one step; return observations, rewards, ends and infos.

        Raises:
            UsageError: as of ``VectorTask.step``.
        """
        seen, rewards, terminated, truncated, infos = self.tasks.step(self._actions)
        ended = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        told: list[dict[str, object]] = [{} for _ in range(self.num_envs)]
        for i in map(int, np.flatnonzero(ended)):
            last = jax.tree.map(lambda leaf, i=i: leaf[i].copy(), infos["final_obs"])
            told[i] = _row(infos["final_info"], i) | {
                "terminal_observation": last,
                "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                "episode": {
                    "r": float(self._returns[i]),
                    "l": int(self._lengths[i]),
                    "t": round(time.monotonic() - self._begun, 6),
                },
            }
            self.reset_infos[i] = _row(infos, i)
        self._returns[ended], self._lengths[ended] = 0.0, 0
        return seen, rewards.astype(np.float32), ended, told

    def get_images(self) -> Sequence[NumpyArray | None]:
        """Return a picture of each environment, or None for each without a render mode."""
        return self.tasks.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: object = None) -> list[object]:
        """Return an attribute of the batch, once for each environment in ``indices``."""
        found = getattr(self.tasks, attr_name)
        return [found for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: object, indices: object = None) -> None:
        """Raise an error: attributes of single environments cannot be set, because all are one batch.

        Raises:
            UsageError: always.
        """
        raise UsageError(f"set_attr {attr_name}: all environments are one batch; give the scenario other numbers")

    def env_method(self, method_name: str, *args: object, indices: object = None, **options: object) -> list[object]:
        """Raise an error: methods of single environments cannot be called, because all are one batch.

        Raises:
            UsageError: always.
        """
        raise UsageError(f"env_method {method_name}: all environments are one batch, .tasks")

    def env_is_wrapped(self, wrapper_class: object, indices: object = None) -> list[bool]:
        """Return False for each environment: none is in a wrapper."""
        return [False for _ in self._get_indices(indices)]

    def close(self) -> None:
        """Close the batch of environments."""
        self.tasks.close()


def _row(infos: Mapping[str, object], i: int) -> dict[str, object]:
    """Return the infos of environment ``i``, from the infos of all."""
    return {name: leaf[i] for name, leaf in infos.items() if isinstance(leaf, np.ndarray) and name[0] != "_"}
