"""Records a world whose vehicles fly by latched orders, so that ``qrsim replay`` can fly it again."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import RunError, warn_user
from qrsim.links.shared.latches import Latches
from qrsim.links.shared.recorded import RESTARTED, STREAM, basic_columns, stacked
from qrsim.links.shared.spoken import Spoken
from qrsim.runs import EpisodesWriter, RunInfo, RunWriter
from qrsim.runs.request_log import RequestLog
from qrsim.runs.streams import EventFinder, columns, values
from qrsim.scenarios.scenario import Scenario
from qrsim.simulation.history import History
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import World

# Ticks that are kept at once, which costs little more than to keep one.
KEPT_TICKS = 25
# Orders of one tick: arrays (n,) or (n, V) by name.
Flown = dict[str, NumpyArray]


class Recording:
    """The recording of a world: a folder with a run folder for each episode.

    A tick never waits for the disk, because another thread writes. Without room on the disk the world flies on.

    Args:
        folder: of recordings; that of this world is made in it.
        scenario: that is flown, as the simulation was built from it.
        simulation: reset.
        latches: orders by which its vehicles fly.

    Raises:
        RunError: the folder cannot be written.

    Attributes:
        folder: of this world.
    """

    def __init__(self, folder: Path, scenario: Scenario, simulation: Simulation, latches: Latches):
        self._scenario, self._simulation, self._latches = scenario, simulation, latches
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S-%f")
        self._episodes = EpisodesWriter.create(folder / f"{stamp}-{scenario.name}".replace("/", "-"), scenario.name)
        self.folder = self._episodes.folder
        self._keeping = ThreadPoolExecutor(1, thread_name_prefix="keep")
        self._writer: RunWriter | None = None
        self.begin()

    def begin(self) -> None:
        """Begin the run folder of an episode at its tick 0, after ``end`` of the last one; raises RunError if it cannot
        be written."""
        simulation, scenario = self._simulation, self._scenario
        self._ticks: list[tuple[int, list[NumpyArray], Flown]] = []
        self._world, self._requests = simulation.world, 0
        self._restarted = np.full(simulation.size, -1)
        self._spoken = None if simulation.world.radio is None else Spoken(simulation)
        beginning = simulation.history
        self._finder = EventFinder(simulation)
        described = [] if self._spoken is None else self._spoken.described()
        self._orders = [*basic_columns(self._latches.numbers.shape[1]), RESTARTED, *described]
        self._columns = columns(simulation.world, beginning)
        info = RunInfo.of_flight(scenario, simulation)
        self._writer = RunWriter.create(
            self._episodes.begin(simulation.seed),
            info=info,
            scenario_yaml=scenario.to_yaml(),
            columns=self._columns | {STREAM: self._orders},
        )
        self._log = RequestLog(simulation, self._writer.note_injection, self._writer.append_event)
        self._keeping.submit(self._write_ticks, self._world, beginning, [self._flown()])

    def restarted(self, row: int) -> None:
        """Record that the vehicle at ``row`` was put back to its start at the present tick, before the tick's
        requests."""
        self._restarted[row] = self._simulation.tick

    def said(self, messages: Sequence[tuple[int, list[float], int]]) -> None:
        """Record radio messages queued at the present tick, each (sender, numbers (D,), receiver or -1 for all)."""
        assert self._spoken is not None
        for sender, numbers, receiver in messages:
            self._spoken.tick[sender], self._spoken.to[sender] = self._simulation.tick, receiver
            self._spoken.numbers[sender] = numbers

    def keep(self) -> None:
        """Store the present state and orders, to be written later by another thread."""
        simulation = self._simulation
        requests = len(simulation.requests)
        if requests != self._requests:
            # The ticks before these requests were flown in the world before them.
            self._submit_ticks()
            self._requests, self._world = requests, simulation.world
            self._keeping.submit(self._write_requests)
        _, state = simulation.packed
        self._ticks.append((simulation.tick, [np.array(part) for part in state], self._flown()))
        if len(self._ticks) >= KEPT_TICKS:
            self._submit_ticks()

    def end(self) -> None:
        """Finish the run folder of an episode; call it before the simulation is reset."""
        self._submit_ticks()
        self._keeping.submit(self._write_requests)
        self._keeping.submit(self._close_writer).result()

    def close(self) -> None:
        """End the recording; no other method may be called afterwards."""
        self.end()
        self._keeping.shutdown()

    def _flown(self) -> Flown:
        """Return column -> values (n,) of the orders by which the present tick was flown."""
        latches = self._latches
        columns = {
            "kind": latches.codes.copy(),
            "numbers": latches.numbers.copy(),
            RESTARTED.name: self._restarted.copy(),
        }
        return columns if self._spoken is None else columns | self._spoken.columns()

    def _submit_ticks(self) -> None:
        """Pass the stored ticks to the thread that writes them."""
        if self._ticks:
            layout, _ = self._simulation.packed
            numbers, states, flown = zip(*self._ticks, strict=True)
            floats, integers = (np.stack(parts) for parts in zip(*states, strict=True))
            history = History(np.array(numbers), self._world.time_step, layout, (floats, integers))
            self._keeping.submit(self._write_ticks, self._world, history, list(flown))
            self._ticks = []

    # ---- in the thread that writes ----

    def _write_ticks(self, world: World, history: History, flown: list[Flown]) -> None:
        """Write some ticks, their orders and their events to the run folder, in the writing thread."""
        if self._writer is None:
            return
        try:
            events = self._finder.find(history)
            arrays = values(world, history, self._columns) | {STREAM: stacked(self._orders, flown)}
            with self._writer.together():
                for stream, of_stream in arrays.items():
                    self._writer.append(stream, history.ticks, history.time, of_stream)
                for event in events:
                    self._writer.append_event(**event)
        except Exception as error:
            # Nobody waits for the result.
            self._stop_recording(error)

    def _write_requests(self) -> None:
        """Write the injection requests made since the last call, in the writing thread."""
        if self._writer is None:
            return
        try:
            self._log.write_new()
        except RunError as error:
            self._stop_recording(error)

    def _close_writer(self) -> None:
        """Mark the run folder as finished and close it."""
        try:
            if self._writer is not None:
                self._writer.close("finished")
        except RunError as error:
            warn_user(str(error))
        self._writer = None

    def _stop_recording(self, error: Exception) -> None:
        """Warn the user of an error in the writing thread, and record nothing more."""
        why = f"{error}" if isinstance(error, RunError) else f"{type(error).__name__}: {error}"
        warn_user(f"nothing more is recorded: {why}")
        self._writer = None
