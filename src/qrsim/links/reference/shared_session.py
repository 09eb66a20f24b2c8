"""A session that several clients share: whose orders are flown, and what is recorded of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from qrsim.links.contracts import Pace, Silence
from qrsim.links.pacing import Metronome, Pacer
from qrsim.links.reference.sensed import Sensed
from qrsim.links.reference.session import PIECE_TICKS, Session, SessionOptions
from qrsim.links.shared.failsafe import believed_of
from qrsim.links.shared.plant import Plant
from qrsim.links.shared.recorded import STREAM, order_columns, order_values
from qrsim.runs import Column
from qrsim.runs.streams import Values

if TYPE_CHECKING:
    from qrsim.view.live import LiveView


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

    def prepare(self) -> None:
        """Make the plant, and compile the one kind of step that there is."""
        self.plant = Plant(self.simulation, self._silence, self._options.realtime, self._note)
        self.warm()

    def warm(self) -> None:
        """Compile the kind of step that is flown, and what a failsafe needs."""
        actions = self.plant.latches.actions()
        if self.ticks_are_kept:
            self.simulation.record(1, actions, PIECE_TICKS)
        else:
            self.simulation.advance(actions)
        believed_of(self.simulation)
        self.simulation.reset()

    def begin(self) -> None:
        """Build the world and start; raises RunError where the recording cannot be written."""
        super().begin()
        self.start_clock()

    def start_clock(self, factor: float | None = None) -> None:
        """Begin to count the pace, at another factor if one is given; raises UsageError for one that is none."""
        factor = self.pacer.factor if factor is None else factor
        if self.pace == "free":
            self.pacer = Metronome(factor, self.time, self.time_step)
        else:
            self.pacer = Pacer(factor, self.time)

    def restart(self, seed: int | None = None) -> None:
        """Start the next episode; all fly by their guidance, and claims stay."""
        super().restart(seed)
        self.start_clock()

    def _start_episode(self) -> None:
        self.plant.restart()
        super()._start_episode()
        self.sensed = Sensed(self.simulation, self.states)

    def _note(self, kind: str, vehicle: str, text: str) -> None:
        """Tell the operator, the recording and whoever asks for events."""
        time = self.simulation.time
        self._say(f"t = {time:.10g} s, '{vehicle}': {text}")
        if self.ticks_are_kept:
            event = {"time": time, "tick": self.simulation.tick, "vehicle": vehicle, "kind": kind, "message": text}
            self.keep_events([event])

    # ---- what is kept ----

    def more_columns(self) -> dict[str, list[Column]]:
        """Return the columns of the orders."""
        return {STREAM: order_columns(self.plant)}

    def more_values(self, ticks: int) -> dict[str, Values]:
        """Return the orders that the last ticks were flown by."""
        return {STREAM: order_values(self.plant, ticks)}
