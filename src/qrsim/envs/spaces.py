"""Gymnasium's spaces of actions and observations."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from qrsim.envs.batch import Batch

SAMPLES, VELOCITY = "samples", "velocity"


def action_space(batch: Batch) -> spaces.Space[Any]:
    """Return the action space of one agent: numbers in [-1, 1], and the answer for tasks that have one."""
    play = batch.functional.play
    flight = spaces.Box(-1.0, 1.0, (len(play.axes),), batch.dtype.type)
    if not play.task.hands_in:
        return flight
    shape = play.task.answer_shape(play.world)
    return spaces.Dict({SAMPLES: spaces.Box(0.0, np.inf, shape, batch.dtype.type), VELOCITY: flight})


def observation_space(seen: Any) -> spaces.Space[Any]:
    """Return the observation space of one agent, from the observations (B, n, ...) of all."""
    if isinstance(seen, dict):
        return spaces.Dict({name: observation_space(part) for name, part in seen.items()})
    if np.issubdtype(seen.dtype, np.integer):
        return spaces.Box(0, np.iinfo(seen.dtype).max, seen.shape[2:], seen.dtype.type)
    return spaces.Box(-np.inf, np.inf, seen.shape[2:], seen.dtype.type)
