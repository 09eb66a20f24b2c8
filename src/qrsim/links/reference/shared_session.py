"""A session that several clients share: whose orders are flown, and what is recorded of them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.engine.layout import Packer
from qrsim.errors import warn_user
from qrsim.links.contracts import Pace, Silence
from qrsim.links.pacing import Metronome, Pacer
from qrsim.links.reference.protocol.qrsim_pb2 import Events
from qrsim.links.reference.sensed import Sensed
from qrsim.links.reference.session import PIECE_TICKS, Session, SessionOptions
from qrsim.links.shared.failsafe import believed_of
from qrsim.links.shared.plant import Plant
from qrsim.links.shared.recorded import STREAM, order_columns, stacked
from qrsim.runs import Column
from qrsim.runs.streams import Values
from qrsim.simulation.history import History

if TYPE_CHECKING:
    from qrsim.view.live import LiveView

# What a tick was flown by (shared/plant.py).
Flown = dict[str, NumpyArray]
# So many ticks are kept at a time, which costs little more than to keep one.
KEPT_TICKS = 25


class SharedSession(Session):
    """A session whose vehicles are flown by the orders of several clients.

    Attributes:
        plant: claims, orders and silence.
        sensed: writes what each vehicle senses.
        pace: "barrier" or "free".
    """

    plant: Plant
    sensed: Sensed

    def __init__(
        self,
        number: int,
        options: SessionOptions,
        view: LiveView | None,
        *,
        pace: Pace,
        silence: Silence,
        say: Callable[[str], None],
    ):
        super().__init__(number, options, view)
        self.pace, self._silence, self._say = pace, silence, say
        # A tick must not wait for a disk: what is kept of it is written by another thread, many ticks at a time.
        self._keeping = ThreadPoolExecutor(1, thread_name_prefix=f"keep-{number}")
        self._ticks: list[tuple[int, list[NumpyArray], Flown]] = []
        self._flown: list[Flown] = []

    def prepare(self) -> None:
        """Create the ``Plant``, which applies the clients' orders, and compile everything in advance."""
        self.plant = Plant(self.simulation, self._silence, self._options.realtime, self._report_event)
        self.warm()

    def warm(self) -> None:
        """Compile the step by orders and the failsafes' functions, by flying them once."""
        actions = self.plant.latches.actions()
        if self.ticks_are_kept:
            self.simulation.record(1, actions, PIECE_TICKS)
        else:
            self.simulation.advance(actions)
        believed_of(self.simulation)
        self.simulation.reset()

    def begin(self) -> None:
        """Build the world and start the first episode; raises RunError if the recording cannot be written."""
        super().begin()
        self.start_clock()

    def start_clock(self, factor: float | None = None) -> None:
        """Start counting the pace from now, at a new real-time factor if one is given; raises UsageError for a bad
        factor."""
        factor = self.pacer.factor if factor is None else factor
        if self.pace == "free":
            self.pacer = Metronome(factor, self.time, self.time_step)
        else:
            self.pacer = Pacer(factor, self.time)
        self.plant.keep_pace(factor)

    def restart(self, seed: int | None = None) -> None:
        """Start the next episode: all vehicles fly by their scenario's guidance, and clients keep their claims."""
        super().restart(seed)
        self.start_clock()

    def _start_episode(self) -> None:
        """Start an episode: write the ticks still queued, end all orders, and renew the stamped readings."""
        self.plant.restart()
        self._drain()
        self._flown = [self.plant.flown]
        super()._start_episode()
        self.sensed = Sensed(self.simulation, self.states)

    def _report_event(self, kind: str, vehicle: str, text: str) -> None:
        """Report an event of a vehicle to the operator, the recording and GET_EVENTS."""
        time = self.simulation.time
        self._say(f"t = {time:.10g} s, '{vehicle}': {text}")
        if self.ticks_are_kept:
            event = {"time": time, "tick": self.simulation.tick, "vehicle": vehicle, "kind": kind, "message": text}
            self.keep_events([event])

    # ---- what is kept ----

    def _advance_ticks(self, command: object, ticks: int) -> None:
        """Advance the simulation by some ticks with the fleets' actions, and queue the states for the writing
        thread."""
        if not self.ticks_are_kept:
            self.simulation.advance(command, ticks)
        elif ticks > 1:
            self.hand_over()
            for done in range(0, ticks, PIECE_TICKS):
                history = self.simulation.record(min(PIECE_TICKS, ticks - done), command, PIECE_TICKS)
                self._keeping.submit(self._record_shared, history, [self.plant.flown] * len(history.ticks))
        else:
            self.simulation.advance(command)
            _, state = self.simulation.packed
            self._ticks.append((self.simulation.tick, [np.array(part) for part in state], self.plant.flown))
            if len(self._ticks) >= KEPT_TICKS:
                self.hand_over()

    def hand_over(self) -> None:
        """Submit the ticks flown so far to the thread that writes the recording."""
        if self._ticks:
            layout, _ = self.simulation.packed
            self._keeping.submit(self._record_ticks, layout, self._ticks)
            self._ticks = []

    def _drain(self) -> None:
        """Wait until the writing thread has written all submitted ticks."""
        self.hand_over()
        self._keeping.submit(int).result()

    def _record_ticks(self, layout: Packer, ticks: list[tuple[int, list[NumpyArray], Flown]]) -> None:
        """Build a history from the packed states of single ticks, and record it with the orders flown."""
        numbers, states, flown = zip(*ticks, strict=True)
        floats, integers = (np.stack(parts) for parts in zip(*states, strict=True))
        history = History(np.array(numbers), self.time_step, layout, (floats, integers))
        self._record_shared(history, list(flown))

    def _record_shared(self, history: History, flown: list[Flown]) -> None:
        """Write a history and the orders flown, in the writing thread; errors become warnings."""
        self._flown = flown
        try:
            self._record_history(history)
        except Exception as error:
            # Who hands over does not wait for the result.
            warn_user(f"session {self.number}: {type(error).__name__} while ticks were kept: {error}")

    def keep_requests(self) -> None:
        """Queue the injection requests for the writing thread, behind the ticks before them."""
        if self._requests.has_new:
            self.hand_over()
            self._keeping.submit(super().keep_requests)

    def keep_events(self, found: list[dict[str, object]]) -> None:
        """Write events into the run folder, in the writing thread."""
        if threading.current_thread().name.startswith("keep-"):
            super().keep_events(found)
        elif found:
            self._keeping.submit(super().keep_events, found)

    def events(self) -> Events:
        """Return the events since the last call, up to the ticks that have been submitted for writing."""
        return self._keeping.submit(super().events).result()

    def more_columns(self) -> dict[str, list[Column]]:
        """Return the columns of the clients' orders, for the recording."""
        return {STREAM: order_columns(self.plant)}

    def more_values(self) -> dict[str, Values]:
        """Return the values (T, n) of the orders' columns for the last T ticks."""
        return {STREAM: stacked(order_columns(self.plant), self._flown)}

    def close_recording(self) -> None:
        """Finish the run folder of the present episode, after all queued ticks."""
        self._drain()
        super().close_recording()

    def end(self) -> None:
        """End the session's recording; no other method may be called afterwards."""
        super().end()
        self._keeping.shutdown(wait=False)
