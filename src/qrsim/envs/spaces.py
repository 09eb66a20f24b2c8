"""Gymnasium's spaces of actions and observations, and what is in an action."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from qrsim.core.arrays import NumpyArray
from qrsim.envs.batch import Batch
from qrsim.errors import UsageError, did_you_mean
from qrsim.tasks import Play
from qrsim.tasks.speaking import ACT, AGE, HEARD, MASK, RSSI, SAY, SEE, SENDER
from qrsim.tasks.teams import side_of

# Of a sample nothing is known before it is looked at.
Space = spaces.Space[Any]


def action_space(batch: Batch, agent: int = 0) -> Space:
    """Return the Gymnasium space of agent number ``agent``'s actions in [-1, 1], with a radio message if it sends any.

    With a radio that is the part ``act`` of a dict, which has a message ``say`` too.
    """
    play = batch.functional.play
    act: Space = spaces.Box(-1.0, 1.0, (len(batch.axes[agent]),), batch.dtype.type)
    if not play.message:
        return act
    return spaces.Dict({ACT: act, SAY: spaces.Box(-np.inf, np.inf, (play.message,), batch.dtype.type)})


def answer_space(batch: Batch) -> spaces.Box | None:
    """Return the Gymnasium space of an agent's answer at the end, None for a task without answers."""
    if not batch.functional.play.task.hands_in:
        return None
    return spaces.Box(0.0, np.inf, batch.answer_shape, batch.dtype.type)


def observation_space(play: Play, seen: Any, agent: int = 0) -> Space:
    """Return the Gymnasium space of agent number ``agent``'s observations, given those of all (B, n, ...)."""
    axes, sides = play.task.sees(play.world), play.sides
    if len(sides) > 1:
        fleet = side_of(sides, agent).fleet
        axes, seen = axes[fleet], seen[fleet]
    if not play.message:
        return _space(seen, axes)
    vehicles = sum(fleet.size for fleet in play.world.fleets)
    size = seen[SENDER].shape[2:]
    return spaces.Dict(
        {
            SEE: _space(seen[SEE], axes),
            HEARD: _space(seen[HEARD]),
            SENDER: spaces.Box(-1, vehicles - 1, size, np.int32),
            AGE: spaces.Box(0.0, np.inf, size, seen[AGE].dtype.type),
            RSSI: _space(seen[RSSI]),
            MASK: spaces.MultiBinary(size),
        }
    )


def split_say(batch: Batch, action: object, who: str, *lead: int) -> tuple[object, NumpyArray]:
    """Split an action into control values and radio message (*lead, D), NaN for none; D = 0 without a radio.

    Raises:
        UsageError: with a radio it is no dict of ``act`` and ``say``, or ``say`` are no D finite numbers.
    """
    size = batch.functional.play.message
    words = np.full((*lead, size), np.nan, batch.dtype)
    if not size:
        return action, words
    if not isinstance(action, dict) or ACT not in action:
        raise UsageError(
            f"{who}: expected a dict of {ACT} and {SAY}, for there is a radio, found {type(action).__name__}"
            + (f" of {', '.join(map(str, action)) or 'nothing'}" if isinstance(action, dict) else "")
        )
    for part in action:
        if part not in (ACT, SAY):
            raise UsageError(f"{who}: there is no part '{part}'{did_you_mean(str(part), (ACT, SAY))}")
    if action.get(SAY) is None:
        return action[ACT], words
    try:
        said = np.asarray(action[SAY], batch.dtype)
    except (TypeError, ValueError, OverflowError):
        raise UsageError(f"{who}: {SAY}: expected numbers of shape {words.shape}, found {action[SAY]!r}") from None
    if said.shape != words.shape:
        raise UsageError(f"{who}: {SAY}: expected shape {words.shape} (world.radio.size), found {said.shape}")
    if not np.isfinite(said).all():
        raise UsageError(
            f"{who}: {SAY}: {said[~np.isfinite(said)][0]} is no finite number; without {SAY} nothing is said"
        )
    return action[ACT], said


def _space(seen: Any, axes: Any = None) -> Space:
    """Return a Gymnasium space in the shape of ``seen``, with the ranges of ``axes`` (None: unbounded)."""
    if isinstance(seen, dict):
        named = axes or {}
        return spaces.Dict({name: _space(part, named.get(name)) for name, part in seen.items()})
    if axes is None or len(axes) != np.prod(seen.shape[2:], dtype=int):
        if np.issubdtype(seen.dtype, np.integer):
            return spaces.Box(0, np.iinfo(seen.dtype).max, seen.shape[2:], seen.dtype.type)
        return spaces.Box(-np.inf, np.inf, seen.shape[2:], seen.dtype.type)
    low, high = (np.array([getattr(axis, end) for axis in axes], seen.dtype) for end in ("low", "high"))
    return spaces.Box(low.reshape(seen.shape[2:]), high.reshape(seen.shape[2:]), dtype=seen.dtype.type)
