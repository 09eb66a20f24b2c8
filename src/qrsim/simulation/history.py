"""The states of several ticks, as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.world.state import State

FloatArray = np.ndarray[Any, Any]


class History:
    """The states of consecutive ticks, as NumPy arrays with the tick as first axis.

    Attributes:
        ticks: (T,) tick numbers.
        time: (T,) simulated time [s].
        state: the State, each leaf with a leading axis T.
    """

    def __init__(self, ticks: FloatArray, time_step: float, state: State):
        self.ticks = ticks
        self.time = ticks * time_step
        self.state = state
