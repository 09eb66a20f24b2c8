"""The states of several ticks, as arrays."""

from __future__ import annotations

from qrsim.core.arrays import Floats
from qrsim.world.state import State


class History:
    """The states of consecutive ticks, as NumPy arrays with the tick as first axis.

    Attributes:
        ticks: (T,) tick numbers.
        time: (T,) simulated time [s].
        state: the State, each leaf with a leading axis T.
    """

    def __init__(self, ticks: Floats, time_step: float, state: State):
        self.ticks = ticks
        self.time = ticks * time_step
        self.state = state
