"""Many episodes side by side, and when the next of each begins: what vector environments have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from gymnasium.vector import AutoresetMode

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.envs.batch import Batch, checked_seed
from qrsim.envs.drawing import Drawing, checked_mode
from qrsim.errors import UsageError, did_you_mean


@dataclass(frozen=True)
class Moved:
    """What a step of E episodes of n agents gives.

    Attributes:
        rewards: (E, n).
        terminated, truncated: (E,).
        gone: (E, n) which agents have stopped, where these leave; else None.
        last: where episodes have ended and others have begun (``SAME_STEP``), what was seen last and what was really
            the case, arrays (E, n, ...) that are zero for the others; None where there are no such.
        ended: (E,) of which these are.
    """

    rewards: NumpyArray
    terminated: NumpyArray
    truncated: NumpyArray
    gone: NumpyArray | None
    last: tuple[Any, dict[str, NumpyArray]] | None
    ended: NumpyArray


class Series:
    """The episodes of a batch, each followed by the next as a mode of Gymnasium says.

    Args:
        batch: as many as there are environments.
        mode: see ``VectorTask``.
        render_mode: as of ``SingleTask``.

    Raises:
        UsageError: there is no such mode.
    """

    def __init__(self, batch: Batch, mode: AutoresetMode | str, render_mode: str | None):
        checked_mode(render_mode)
        self.batch, self.mode = batch, mode_of(mode)
        self._drawings = [] if render_mode is None else [Drawing(batch, row) for row in range(batch.size)]
        self._over = np.zeros(batch.size, bool)

    def reset(self, seed: object, options: dict[str, object] | None) -> None:
        """Start the next episodes, or a seed's series, in all environments or those of ``options["reset_mask"]``."""
        size = self.batch.size
        rows = self.rows((options or {}).get("reset_mask"), "reset_mask")
        if len(rows) < size and not self.batch.episodes.started:
            raise UsageError("reset_mask: nothing has begun yet; the first reset is of all environments")
        self.batch.take_options(options)
        if seed is None and self.batch.episodes.started:
            self.batch.again(rows)
        else:
            first = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
            table = np.asarray(first, object)
            given = list(table) if table.ndim else [checked_seed(first) + i for i in range(size)]
            if len(given) != size or any(given[row] is None for row in rows):
                raise UsageError(f"seed: expected one for each of {size} environments, found {len(given)}")
            self.batch.reset([given[row] for row in rows], rows)
        self._over[rows] = False
        self._begin_drawings(rows)

    def rows(self, given: object, what: str) -> NumpyArray:
        """Return the indices of the environments in a mask (all for None); raise UsageError for an invalid one.

        Raises:
            UsageError: it has another shape or type.
        """
        size = self.batch.size
        mask = np.ones(size, bool) if given is None else np.asarray(given)
        if mask.shape != (size,) or mask.dtype != np.bool_:
            raise UsageError(f"{what}: expected shape ({size},) of bool, found {mask.shape} of {mask.dtype.name}")
        return np.flatnonzero(mask)

    def check_going(self) -> None:
        """Raise UsageError for a step after an episode's end without a reset (autoreset mode ``DISABLED``).

        Raises:
            UsageError: that.
        """
        if self.mode is AutoresetMode.DISABLED and self._over.any():
            raise UsageError(
                f"the episode of environment {np.flatnonzero(self._over)[0]} has ended: call reset() with a reset_mask"
            )

    def step(self, actions: NumpyArray, words: NumpyArray) -> Moved:
        """Advance all by actions (E, n, A) and radio messages (E, n, D); restart ended episodes if the mode says so.

        Raises:
            UsageError: nothing has started, or actions that are not finite or out of range.
        """
        waiting = self._over
        if waiting.any():
            # These episodes are over, and what becomes of them is not seen.
            idle = waiting[:, None, None]
            actions, words = (np.where(idle, np.zeros((), each.dtype), each) for each in (actions, words))
        reward, terminated, truncated = self.batch.step(actions, words, "actions")
        rewards, ended = reward.astype(np.float64), (terminated | truncated) & ~waiting
        at_the_end = np.flatnonzero(truncated & ~waiting)
        rewards[at_the_end] += self.batch.scores(at_the_end)
        for drawing in self._drawings:
            drawing.moved()
        last, gone = None, self.batch.gone
        if gone is not None:
            gone = gone & ~waiting[:, None]
        if self.mode is AutoresetMode.SAME_STEP:
            if ended.any():
                last = jax.tree.map(lambda leaf: _where(ended, leaf), (self.batch.seen, self.batch.truth))
                self._restart_rows(np.flatnonzero(ended))
        elif waiting.any():
            self._restart_rows(np.flatnonzero(waiting))
            rewards[waiting], terminated, truncated = 0.0, terminated & ~waiting, truncated & ~waiting
        self._over = ended if self.mode is not AutoresetMode.SAME_STEP else np.zeros_like(ended)
        return Moved(rewards, terminated, truncated, gone, last, ended)

    def frames(self) -> tuple[Floats, ...] | None:
        """Return a picture of each environment from above; None without a render mode."""
        return tuple(drawing.frame() for drawing in self._drawings) or None

    def _restart_rows(self, rows: NumpyArray) -> None:
        """Start the next episodes in the environments ``rows``."""
        self.batch.again(rows)
        self._begin_drawings(rows)

    def _begin_drawings(self, rows: NumpyArray) -> None:
        """Start new drawings in the environments ``rows``, where episodes have begun."""
        for row in rows if self._drawings else ():
            self._drawings[row].begin()


def mode_of(given: AutoresetMode | str) -> AutoresetMode:
    """Return Gymnasium's autoreset mode from the mode itself, its name or its value; raise UsageError for others.

    Raises:
        UsageError: there is none such.
    """
    named = {mode.name: mode for mode in AutoresetMode} | {mode.value: mode for mode in AutoresetMode}
    if isinstance(given, AutoresetMode):
        return given
    if str(given) not in named:
        modes = [mode.name for mode in AutoresetMode]
        raise UsageError(f"autoreset_mode: there is no '{given}'{did_you_mean(str(given).upper(), modes)}")
    return named[str(given)]


def _where(ended: NumpyArray, leaf: NumpyArray) -> NumpyArray:
    """Return a copy of ``leaf`` (E, ...) with zeros where the environment's episode has not ended (``ended``)."""
    shaped = ended.reshape(-1, *(1,) * (leaf.ndim - 1))
    return np.where(shaped, leaf, np.zeros((), leaf.dtype))
