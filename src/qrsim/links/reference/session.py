"""One client's simulation; its methods are called one at a time, from any thread."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from qrsim.errors import RunError, UsageError, warn_user
from qrsim.files import Content
from qrsim.links.pacing import Pacer
from qrsim.links.reference.commands import Commands, commands_of, rows_of
from qrsim.links.reference.protocol.qrsim_pb2 import Arrayd, Events
from qrsim.links.reference.readout import States
from qrsim.links.reference.seeds import Seeds
from qrsim.links.reference.sensors import SensorReadout
from qrsim.runs import Column, EpisodesWriter, RunInfo, RunWriter
from qrsim.runs.request_log import RequestLog
from qrsim.runs.streams import EventFinder, Values, columns, values
from qrsim.scenarios.scenario import Scenario
from qrsim.simulation.history import History
from qrsim.simulation.simulation import Simulation

if TYPE_CHECKING:
    from qrsim.view.live import LiveView

# How far a dt, often a sum of rounded numbers, may be from a whole number of time steps: in time steps, and of itself.
DT_TOLERANCE, DT_RELATIVE_TOLERANCE = 1e-6, 1e-9
# Of one STEP, so that a slip of the pen does not keep the server busy for days.
MOST_TICKS = 1_000_000
# Between two of its pieces a long step notices that its client has gone.
PIECE_S = 0.25
PIECE_TICKS = 50
# What takes less than this is not handed to another thread, which would take as long.
SHORT_S = 0.0005
MOST_EVENTS = 10_000


@dataclass(frozen=True)
class SessionOptions:
    """Options of a session.

    Attributes:
        scenario: what to fly, offboard.
        seeds: of its episodes.
        realtime: simulated seconds per second of the wall clock; 0: lock-step.
        events: collect events.
        record: folder for the recordings of sessions; None: not recorded.
    """

    scenario: Scenario
    seeds: Seeds
    realtime: float = 0.0
    events: bool = False
    record: Path | None = None


class Session:
    """A simulation as one client sees it. Call ``begin`` first, in the compiling thread.

    Attributes:
        number: its id.
        scenario: what is flown.
        thread: a thread of its own, for what takes long.
        simulation, states, pacer: of the present episode.
        sensors: tells what the sensors say.
        commands: makes commands of STEPs.
        episode: how many episodes it has begun.
    """

    simulation: Simulation
    commands: Commands
    states: States
    sensors: SensorReadout
    pacer: Pacer

    def __init__(self, number: int, options: SessionOptions, view: LiveView | None = None):
        self.number = number
        self._view = view
        self.scenario = options.scenario
        self.thread = ThreadPoolExecutor(1, thread_name_prefix=f"session-{number}")
        self._options, self._seeds = options, options.seeds
        self._seconds: dict[object, tuple[float, int]] = {}
        self._events: deque[Content] = deque()
        self._lost_events = 0
        self._writer: RunWriter | None = None
        self._finder: EventFinder | None = None
        self._columns: Content = {}
        self._recording: EpisodesWriter | None = None
        self.episode = 0

    @property
    def size(self) -> int:
        """Number of vehicles of the session."""
        return self.simulation.size

    @property
    def seed(self) -> int:
        """Seed of the present episode."""
        return self.simulation.seed

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.simulation.time

    @property
    def time_step(self) -> float:
        """Simulation step [s]."""
        return self.simulation.world.time_step

    def begin(self) -> None:
        """Build the world and start the first episode; in real time, compile everything in advance.

        Raises:
            RunError: the recording cannot be written.
        """
        scenario, options = self.scenario, self._options
        self.simulation = Simulation(
            scenario.world(), seed=self._seeds.next(), name=scenario.name, site=scenario.site, number=0
        )
        self.simulation.reset()
        self.commands = commands_of(self.simulation.world.fleets, self.simulation.dtype)
        self.prepare()
        self._start_episode()
        self.pacer = Pacer(options.realtime, 0.0)
        if self._view is not None:
            self._view.begin(self.simulation, f"{scenario.name}, session {self.number}")

    def prepare(self) -> None:
        """Compile everything before the first episode if the session runs in real time."""
        if self._options.realtime:
            self.warm()

    def warm(self) -> None:
        """Compile every kind of command by flying it once from the start, and reset."""
        start = self.simulation.truth.position_ned
        self.simulation.set_state(np.full_like(start, np.nan))
        for command in self.commands.samples(start):
            if self.ticks_are_kept:
                self.simulation.record(1, command, PIECE_TICKS)
            else:
                self.simulation.advance(command)
        self.simulation.reset()

    def start_clock(self, factor: float) -> None:
        """Start counting the pace at a real-time factor (0: lock-step); raises UsageError for a bad factor."""
        self.pacer = Pacer(factor, self.time)

    def restart(self, seed: int | None = None) -> None:
        """Start the next episode; with ``seed``, the first one of the series of seeds that begins with it.

        Raises:
            UsageError: it is no seed.
            RunError: a fleet found no place.
        """
        if seed is not None:
            self._seeds = self._seeds.begin(seed)
        self.simulation.reset(self._seeds.next())
        self._start_episode()
        self.pacer.restarted()
        if self._view is not None:
            self._view.show(self.simulation)

    def _start_episode(self) -> None:
        """Start an episode: new encoders of replies, a new log of requests, and a new run folder if it is recorded."""
        self.states, self.sensors = States(self.simulation), SensorReadout(self.simulation)
        self.close_recording()
        self.episode += 1
        self._requests = RequestLog(self.simulation, self._write_injection, lambda **event: self.keep_events([event]))
        if not self.ticks_are_kept:
            return
        beginning = self.simulation.history
        self._finder = EventFinder(self.simulation)
        if self._options.record is not None:
            self._columns = columns(self.simulation.world, beginning) | self.more_columns()
            self._writer = self._new_writer(self._options.record)
        self._record_history(beginning)

    @property
    def ticks_are_kept(self) -> bool:
        """Whether every tick has to be examined, for events or for a recording."""
        return self._options.events or self._options.record is not None

    def _new_writer(self, folder: Path) -> RunWriter:
        """Create the run folder of the present episode, and return its writer."""
        simulation = self.simulation
        info = RunInfo.of_flight(self.scenario, simulation)
        if self._recording is None:
            stamp = datetime.now().strftime("%Y%m%d-%H%M%S-%f")
            name = f"{stamp}-{self.scenario.name}-session{self.number}".replace("/", "-")
            self._recording = EpisodesWriter.create(folder / name, self.scenario.name)
        episode = self._recording.begin(simulation.seed)
        return RunWriter.create(episode, info=info, scenario_yaml=self.scenario.to_yaml(), columns=self._columns)

    # ---- steps ----

    def ticks(self, dt: float) -> int:
        """Convert a time ``dt`` [s] to ticks; raises UsageError unless it is a whole number of ticks above 0.

        Raises:
            UsageError: it is not a positive multiple.
        """
        step = self.time_step
        count = dt / step
        tolerance = max(DT_TOLERANCE, DT_RELATIVE_TOLERANCE * count)
        if not (math.isfinite(count) and count > 0.5 and abs(count - round(count)) <= tolerance):
            raise UsageError(f"dt: {dt:g} s is not a positive multiple of the time step, {step:g} s")
        if count > MOST_TICKS + 0.5:
            raise UsageError(f"dt: {dt:g} s is {count:.0f} time steps; allowed: up to {MOST_TICKS} in one STEP")
        return round(count)

    def expected_s(self, command: object, ticks: int) -> float:
        """Return the expected wall time [s] of ``ticks`` with a kind of command; infinite for a kind not flown yet."""
        seconds, measured = self._seconds.get(_command_kind(command), (math.inf, 1))
        return seconds * max(1.0, ticks / measured)

    def piece(self, command: object, ticks: int) -> int:
        """Return how many of ``ticks`` to advance in one call, so that the call takes about PIECE_S [s]."""
        if _command_kind(command) not in self._seconds:
            return min(ticks, PIECE_TICKS)
        seconds, measured = self._seconds[_command_kind(command)]
        return min(ticks, max(PIECE_TICKS, int(PIECE_S * measured / seconds)))

    def advance(self, command: object, ticks: int) -> None:
        """Advance the simulation by a number of ticks with a command.

        Raises:
            UsageError: the command cannot be flown; nothing has changed.
        """
        begun = time.perf_counter()
        if self.ticks_are_kept:
            self.keep_requests()
        self._advance_ticks(command, ticks)
        if self._view is not None:
            self._view.show(self.simulation)
            self._view.change(self.simulation)
        # The first call compiles, which says nothing about the next one.
        known = _command_kind(command) in self._seconds
        self._seconds[_command_kind(command)] = (
            (time.perf_counter() - begun, ticks) if known else (PIECE_S, PIECE_TICKS)
        )

    def _advance_ticks(self, command: object, ticks: int) -> None:
        """Advance the simulation by some ticks with a command, and record every tick if needed."""
        if self.ticks_are_kept:
            for done in range(0, ticks, PIECE_TICKS):
                self._record_history(self.simulation.record(min(PIECE_TICKS, ticks - done), command, PIECE_TICKS))
        else:
            self.simulation.advance(command, ticks)

    def set_state(self, given: Sequence[Arrayd]) -> None:
        """Set the vehicles' states from rows of 3, 6, 12 or 13 numbers; raises UsageError for invalid ones.

        Raises:
            UsageError: wrong numbers, or a state beyond area and limits or in collision.
        """
        rows = np.array(rows_of(given, (3, 6, 12, 13), "X", self.simulation.vehicle_names), np.float64)
        # A STATE has no thrust of a vehicle without one.
        wrong = ~np.isfinite(rows[:, :12]).all(axis=1) | np.isinf(rows[:, 12:]).any(axis=1)
        if wrong.any():
            i = int(np.argmax(wrong))
            raise UsageError(f"X of vehicle {i} ('{self.simulation.vehicle_names[i]}') is not finite")
        with np.errstate(over="ignore"):
            self.simulation.set_state(rows)
        if self._view is not None:
            self._view.show(self.simulation)

    # ---- what is kept ----

    def more_columns(self) -> dict[str, list[Column]]:
        """Return the extra columns that a subclass writes into the recording; none here."""
        return {}

    def more_values(self) -> dict[str, Values]:
        """Return the values (T, n) of a subclass's extra columns for the last T ticks; none here."""
        return {}

    def _record_history(self, history: History) -> None:
        """Find the events in a history of states, and write both to the run folder."""
        assert self._finder is not None
        events = self._finder.find(history)
        if self._writer is None:
            self.keep_events(events)
            return
        arrays = values(self.simulation.world, history, self._columns) | self.more_values()
        try:
            with self._writer.together():
                for stream, stream_values in arrays.items():
                    self._writer.append(stream, history.ticks, history.time, stream_values)
                self.keep_events(events)
        except RunError as error:
            # The client flies on: it is the operator who has no room.
            warn_user(f"session {self.number} is no longer recorded: {error}")
            self._writer = None

    def keep_requests(self) -> None:
        """Write the injection requests since the last call to the recording, and keep them for GET_EVENTS."""
        self._requests.write_new()

    def _write_injection(self, entry: Mapping[str, object]) -> None:
        """Write one injection request, an entry of ``injections.yaml``, to the recording."""
        if self._writer is not None:
            self._writer.note_injection(entry)

    def keep_events(self, found: list[Content]) -> None:
        """Keep events for GET_EVENTS, and write them to the recording."""
        if self._options.events:
            self._events.extend(found)
            while len(self._events) > MOST_EVENTS:
                self._events.popleft()
                self._lost_events += 1
        if self._writer is not None:
            for event in found:
                self._writer.append_event(**event)

    def events(self) -> Events:
        """Return the events since the last call as a protobuf message.

        Raises:
            UsageError: they are not collected.
        """
        if not self._options.events:
            raise UsageError("this session collects no events: it was not opened with OPEN and events")
        found = Events(lost=self._lost_events)
        for event in self._events:
            optional = {key: event[key] for key in ("vehicle", "field", "value") if event.get(key) is not None}
            found.event.add(t=event["time"], kind=event["kind"], message=event.get("message", ""), **optional)
        self._events.clear()
        self._lost_events = 0
        return found

    def close_recording(self) -> None:
        """Finish the run folder of the present episode."""
        if self._writer is None:
            return
        try:
            self._writer.close("finished")
        except RunError as error:
            warn_user(f"session {self.number}: {error}")
        self._writer = None

    def summary(self) -> str:
        """Return a line for the operator on what the session flew."""
        report = self.pacer.report()
        late = f", {report.overruns} late, at worst by {1e3 * report.worst_delay:.1f} ms" if report.factor else ""
        episodes = f" in {self.episode} episodes" if self.episode > 1 else ""
        return f"{report.steps} steps, {report.simulated:g} s{episodes}{late}"

    def end(self) -> None:
        """End the session's recording; no other method may be called afterwards."""
        self.close_recording()
        if self._view is not None:
            self._view.note("The session has ended. The page waits for the next client.")
        self.thread.shutdown(wait=False)


def _command_kind(command: object) -> object:
    """Return the key of a kind of command: its type, or {fleet: type} for commands by fleet."""
    if isinstance(command, Mapping):
        return tuple((name, type(part)) for name, part in command.items())
    return type(command)
