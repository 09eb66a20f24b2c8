"""Sending messages by the radios of a simulation, and reading their inboxes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from qrsim.core.tree import replace
from qrsim.engine.layout import Buffers, Packer
from qrsim.errors import UsageError
from qrsim.interface.messages import Message, Say, messages, outboxes, receiver_number
from qrsim.simulation.alone import Alone, alone
from qrsim.simulation.one_world import OneWorld
from qrsim.world.state import State, World


def no_seen_state() -> None:
    """Return None, like a weak reference to a state that no longer exists."""


class Radios(Alone):
    """The part of a ``Simulation`` that sends and receives messages; it adds nothing to its attributes."""

    world: World
    tick: int
    dtype: Any
    vehicle_names: tuple[str, ...]
    precision_context: Callable[[], Any]
    _ticks: OneWorld
    _state: Buffers | None
    _now: Callable[[], Any]

    @property
    def state(self) -> State:
        """Whole state as NumPy arrays."""
        raise NotImplementedError

    def _running(self) -> tuple[Packer, Buffers]:
        """Return the layout and buffers of the present state; raises UsageError before the first reset."""
        raise NotImplementedError

    def send(self, vehicle: str | int, payload: object, to: str | int | None = None) -> None:
        """Queue a message at a vehicle's radio, which sends it at its next turn (docs/howto/radio.md).

        Args:
            vehicle: name or number of the sender.
            payload: at most ``world.radio.size`` numbers.
            to: name or number of the only receiver; None: all vehicles.

        Raises:
            UsageError: no radio, no vehicle of that name, or a payload that is too long or contains no numbers.
        """
        self.send_all([(vehicle, payload, to)])

    @alone
    def send_all(self, messages: Sequence[tuple[str | int, Any, str | int | None]]) -> None:
        """Queue several messages (vehicle, payload, to) at vehicles' radios, all or none; see ``send``.

        Raises:
            UsageError: as of ``send``.
        """
        layout, before = self._running()
        if self.world.radio is None:
            raise UsageError("send: the scenario has no world.radio")
        checked = [self._checked(*message) for message in messages]
        state = layout.unpack(tuple(np.array(part) for part in before))  # type: ignore[arg-type]
        radio = state.radio
        for sender, payload, receiver in checked:
            radio = self.world.radio.handed(radio, sender, payload, receiver, self.tick)
        with self.precision_context():
            self._state, self._now = self._ticks.adopt(layout.pack(replace(state, radio=radio))), no_seen_state

    def _checked(self, vehicle: str | int, payload: object, to: str | int | None) -> tuple[int, Any, int]:
        """Check a message; return the sender's number, its numbers (D,) and the receiver's number; raises
        UsageError."""
        sender, receiver = self._vehicle_number("send", vehicle), receiver_number(to, self.vehicle_names, "send: to")
        (outbox,) = outboxes(Say([payload], to=receiver), self.world, [[""]], self.dtype, False)
        return sender, outbox.payload[:, 0], receiver

    def inbox(self, vehicle: str | int) -> list[Message]:
        """Return the radio messages that a vehicle has received, the newest of each sender.

        Raises:
            UsageError: no radio, or no vehicle of that name.
        """
        if self.world.radio is None:
            raise UsageError("inbox: the scenario has no world.radio")
        return messages(self.world, self.state, self.tick, [self._vehicle_number("inbox", vehicle)])[0]

    def inboxes(self) -> list[list[Message]]:
        """Return the received radio messages of every vehicle, as ``inbox`` does; raises UsageError without a radio."""
        if self.world.radio is None:
            raise UsageError("inboxes: the scenario has no world.radio")
        return messages(self.world, self.state, self.tick, range(len(self.vehicle_names)))

    def _vehicle_number(self, what: str, vehicle: str | int) -> int:
        """Return a vehicle's number for its name or number; raises UsageError, beginning with ``what``, if unknown."""
        number = receiver_number(vehicle, self.vehicle_names, f"{what}: vehicle")
        if number < 0:
            raise UsageError(f"{what}: vehicle: name one, or give its number")
        return number
