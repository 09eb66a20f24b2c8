"""The states of several ticks, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.engine.layout import Buffers, Packer
from qrsim.world.state import State


class History:
    """The states of consecutive ticks, as NumPy arrays with the tick as first axis.

    Args:
        ticks: (T,) their numbers.
        time_step: length of a tick [s].
        layout: of the packed states.
        rows: packed states, each buffer (T, ...).

    Attributes:
        ticks: (T,) tick numbers.
        time: (T,) simulated time [s].
        state: the State, each leaf with a leading axis T.
    """

    def __init__(self, ticks: Floats, time_step: float, layout: Packer, rows: Buffers):
        self.ticks = ticks
        self.time = ticks * time_step
        self._parts = time_step, layout, rows

    @classmethod
    def joined(cls, histories: Sequence[History]) -> History:
        """Join consecutive histories to one, which unpacks as fast as a single one."""
        if len(histories) == 1:
            return histories[0]
        time_step, layout, _ = histories[0]._parts
        floats, integers = (np.concatenate([each._parts[2][i] for each in histories]) for i in (0, 1))
        return cls(np.concatenate([each.ticks for each in histories]), time_step, layout, (floats, integers))

    @property
    def bytes_per_tick(self) -> int:
        """Size [bytes] of the packed state of one tick."""
        return sum(part.nbytes for part in self._parts[2]) // max(len(self.ticks), 1)

    @cached_property
    def state(self) -> State:
        """States of all T ticks, unpacked: a State with arrays (T, ...)."""
        _, layout, rows = self._parts
        found: State = layout.unpack(rows)
        return found
