"""What controllers of a shared world have said over the radio, handed to it tick by tick, and recorded."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.runs import Column
from qrsim.simulation.simulation import Simulation

TICK, TO = "said_tick", "said_to"


class Spoken:
    """Messages of the vehicles (n,) of a simulation with a radio.

    Attributes:
        waiting: by number of a vehicle, what it says at the next tick: D numbers, and number of the receiver, -1: all.
        tick: (n,) at which each has said its last message; -1: none.
        to: (n,) who alone is to hear that; -1: all.
        numbers: (n, D) of it.
    """

    def __init__(self, simulation: Simulation):
        assert simulation.world.radio is not None
        self.waiting: dict[int, tuple[list[float], int]] = {}
        self.tick, self.to = np.full(simulation.size, -1), np.full(simulation.size, -1)
        self.numbers = np.zeros((simulation.size, simulation.world.radio.size))

    def hand_over(self, simulation: Simulation) -> None:
        """Queue the stored messages at the vehicles' radios."""
        for vehicle, (numbers, to) in self.waiting.items():
            self.tick[vehicle], self.to[vehicle], self.numbers[vehicle] = simulation.tick, to, numbers
        self.waiting = {}
        self.say_again(simulation)

    def say_again(self, simulation: Simulation) -> None:
        """Queue the messages of the present tick, stored here or loaded by ``read``, at the vehicles' radios."""
        now = np.flatnonzero(self.tick == simulation.tick).tolist()
        if now:
            simulation.send_all(list(zip(now, self.numbers[now], self.to[now].tolist(), strict=True)))

    def columns(self) -> dict[str, NumpyArray]:
        """Return column -> values (n,) of the radio messages queued at this tick, for the recording."""
        numbers = {name: column.copy() for name, column in zip(self.names(), self.numbers.T, strict=True)}
        return {TICK: self.tick.copy(), TO: self.to.copy()} | numbers

    def names(self) -> list[str]:
        """Return the names of the recording's columns for a radio message."""
        return [f"said_{i}" for i in range(self.numbers.shape[1])]

    def described(self) -> list[Column]:
        """Return the descriptions of the recording's columns for radio messages."""
        return [
            Column(TICK, "", "at which its controller's last message was handed to its radio; -1: none", "int64"),
            Column(TO, "", "number of the vehicle that alone was to hear it; -1: all", "int32"),
            *(Column(name, "", f"number {i} of it", "float64") for i, name in enumerate(self.names())),
        ]

    def read(self, arrays: Mapping[str, NumpyArray], row: int) -> None:
        """Load the radio messages in one row (a tick) of a recording's columns."""
        self.tick[...], self.to[...] = arrays[TICK][row], arrays[TO][row]
        for i, name in enumerate(self.names()):
            self.numbers[:, i] = arrays[name][row]
