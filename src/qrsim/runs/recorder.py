"""Flies a simulation and records it, at full speed or against the wall clock."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from qrsim.errors import RunError, warn_user
from qrsim.interface.crowds import warn_of_overfull
from qrsim.runs import RunInfo, RunWriter
from qrsim.runs.layout import check_every
from qrsim.runs.request_log import RequestLog
from qrsim.runs.streams import STREAMS, EventFinder, columns, values
from qrsim.scenarios.scenario import Scenario
from qrsim.simulation.history import History
from qrsim.simulation.injections import Injection
from qrsim.simulation.schedule import Schedule
from qrsim.simulation.simulation import Simulation

if TYPE_CHECKING:
    from qrsim.simulation.pilot import Pilot
    from qrsim.tasks.places import Places
    from qrsim.tasks.referee import Referee

CHUNK_TICKS = 50
# What is done once a chunk takes longer than its ticks, unless these are many; their states are to stay near the core.
LONG_CHUNK_TICKS, LONG_CHUNK_BYTES = 2000, 16_000_000
REALTIME_CHUNK_S = 0.1
# Ticks of user's functions that take longer than this together are kept at once [s].
CHUNK_S = 1.0


@dataclass(frozen=True)
class Pace:
    """Ticks and wall time of a recording.

    Attributes:
        simulated_s: simulated time.
        timed_s: the part of it that ``wall_s`` measures: all but the first tick.
        wall_s: wall time of the flight, without start-up and the first tick.
        start_up_s: wall time until the first tick was done, since the user began to wait.
        first_tick_unix_s: when the first tick was done [s since 1970], for whoever started the process.
        overruns: chunks that were finished too late in real time.
    """

    simulated_s: float
    timed_s: float
    wall_s: float
    start_up_s: float
    first_tick_unix_s: float
    overruns: int

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds per wall second."""
        return self.timed_s / self.wall_s if self.wall_s > 0 else 0.0


class Watcher(Protocol):
    """Observer of a simulation in flight, which may pace it: a page (see ``qrsim.view.live``)."""

    def begin(self, simulation: Simulation, title: str, places: Places | None = None) -> None:
        """Show a simulation at its start, with title and the places of its task."""

    def note(self, text: str) -> None:
        """Show one line of text about the whole run; "" clears it."""

    def offer(self, history: History) -> None:
        """Show the vehicles' states flown since the last call."""

    def change(self, simulation: Simulation) -> None:
        """Apply to the simulation the changes that users of the 3-D page requested since the last call."""

    def wait(self, ticks: int) -> int:
        """Wait until the page lets the simulation go on; return how many ticks to fly, at most ``ticks``."""


class Flyer(Protocol):
    """Who flies a simulation from outside: a user's functions (``Pilot``), or an autopilot's firmware."""

    def record(self, ticks: int, capacity: int = CHUNK_TICKS) -> History:
        """Fly at most ``ticks`` ticks and return their states; ``capacity`` sizes the compiled program's record."""


def fly(
    scenario: Scenario,
    folder: Path,
    *,
    seed: int,
    precision: str,
    every: Mapping[str, int] | None = None,
    realtime: bool = False,
    policy: object = None,
    estimator: object = None,
    policy_ticks: int = 1,
    progress: Callable[[float, float], None] = lambda simulated_s, wall_s: None,
    command_line: Sequence[str] | None = None,
    view: Watcher | None = None,
    flown_by: Callable[[Simulation], Flyer] | None = None,
    begun: float | None = None,
    injections: Sequence[Injection] = (),
) -> Pace:
    """Fly a scenario from start to end, record it in a run folder, and return the simulation's pace.

    Args:
        scenario: what to fly.
        folder: the run folder; must not exist.
        seed: of all randomness.
        precision: float32 or float64.
        every: stream -> N: of this stream only the ticks that N divides are kept. Events are all kept.
        realtime: pace the flight against the wall clock.
        policy: commands the vehicles, see ``qrsim.interface.policies``; None: every fleet's own guidance.
        estimator: feeds the controllers in place of the sensors, see ``qrsim.interface.policies``.
        policy_ticks: ticks between two calls of the policy.
        progress: called after every chunk with simulated and wall time [s].
        command_line: words to note in the run folder, by default those of this process.
        view: page that shows the flight, and says how fast it goes.
        flown_by: makes of the simulation, at its start, who flies it in place of a policy and an estimator.
        begun: since when the user waits, as ``time.perf_counter`` counts; None: since this call.
        injections: requests of another flight that are made again at their ticks, see ``read_injections``.

    Raises:
        UsageError: the folder exists, or ``every`` names no stream or is no integer from 1.
        RunError: the log cannot be written, or the user's functions fail; what was flushed before stays readable.
    """
    begun = time.perf_counter() if begun is None else begun
    check_every(every or {}, STREAMS)
    simulation = Simulation(scenario.world(precision), seed=seed, name=scenario.name, site=scenario.site)
    info = RunInfo.of_flight(scenario, simulation, every=every, command_line=command_line)
    make_parent(folder)
    simulation.reset()
    referee = _referee(scenario, simulation)
    if view is not None:
        view.begin(simulation, f"{scenario.name}, seed {seed}", None if referee is None else referee.places)
    beginning, finder = simulation.history, EventFinder(simulation)
    wanted = columns(simulation.world, beginning)
    pilot: Flyer | None = None
    if flown_by is not None:
        pilot = flown_by(simulation)
    elif not (policy is None and estimator is None):
        pilot = _new_pilot(simulation, policy, estimator, policy_ticks)
    schedule = Schedule(simulation, injections)
    schedule.make()
    # The first tick alone, so that compiling does not count as flying.
    if view is not None:
        view.note("The vehicles stand still until their programs are compiled.")
    [first] = _record(simulation, 1, pilot)
    if view is not None:
        view.note("")
    start_up, first_tick = time.perf_counter() - begun, time.time()
    compiler, refused = simulation.compiled_by
    info = replace(info, compiler=compiler, compiler_refused=refused)
    if not gc.isenabled():
        # Imports and compiling have left hundreds of thousands of objects, which no collection need search.
        gc.freeze()
        gc.enable()
    with RunWriter.create(folder, info=info, scenario_yaml=scenario.to_yaml(), columns=wanted) as writer:
        requests = RequestLog(simulation, writer.note_injection, writer.append_event)

        def keep(history: History) -> None:
            """Write the ticks of a history, and the requests made before them, to the run folder, and update the 3-D
            page."""
            arrays = values(simulation.world, history, wanted)
            with writer.together():
                # What was asked for before these ticks.
                requests.write_new()
                for stream in STREAMS:
                    writer.append(stream, history.ticks, history.time, arrays[stream])
                for event in finder.find(history):
                    writer.append_event(**event)
            if referee is not None and history is not beginning:
                referee.watch(history)
            if view is not None:
                view.offer(history)
                view.change(simulation)

        keep(beginning)
        keep(first)
        # A page has a clock of its own.
        paced = realtime and view is None
        # A page, a pilot and a referee want short ones.
        long = compiler == "llvm" and pilot is None and view is None and referee is None and not schedule
        many = max(CHUNK_TICKS, min(LONG_CHUNK_TICKS, LONG_CHUNK_BYTES // first.bytes_per_tick))
        with _scored(referee, writer, policy):
            begun_at = (start_up, first_tick)
            pace = _loop(
                simulation,
                scenario.ticks,
                begun_at,
                paced,
                pilot,
                keep,
                progress,
                schedule,
                view,
                many if long else CHUNK_TICKS,
            )
        # Also those that were made after the last tick of the other flight.
        schedule.make()
        requests.write_new()
        for event in finder.ending(simulation.history):
            writer.append_event(**event)
        warn_of_overfull(simulation.world, simulation.state)
        return pace


def _referee(scenario: Scenario, simulation: Simulation) -> Referee | None:
    """Return the scorer of the scenario's task; None for a scenario without a task."""
    if not scenario.steps:
        return None
    # Imported here, because most runs have none.
    from qrsim.tasks.play import Play
    from qrsim.tasks.referee import Referee

    play = Play(scenario.task(simulation.precision), simulation.world, scenario.steps)
    return Referee(play, simulation.seed, simulation.number, simulation.history)


@contextmanager
def _scored(referee: Referee | None, writer: RunWriter, policy: object) -> Iterator[None]:
    """Context manager: write the task's score when the flight in the block ends, also if it is interrupted."""
    try:
        yield
    except KeyboardInterrupt:
        if referee is not None:
            writer.note_score(referee.finish().to_json())
        raise
    if referee is not None:
        from qrsim.tasks.contracts import Answering

        answer = policy.answer() if referee.asks and isinstance(policy, Answering) else None
        writer.note_score(referee.finish(answer).to_json())


def _new_pilot(simulation: Simulation, policy: object, estimator: object, policy_ticks: int) -> Pilot:
    """Return the pilot that calls a user's policy every ``policy_ticks`` ticks, and the user's estimator."""
    # Imported here, because most runs have none.
    from qrsim.simulation.pilot import Pilot

    own = [fleet.name for fleet in simulation.world.fleets if fleet.estimator is not None]
    if estimator is not None and own:
        warn_user(
            f"estimator: yours feeds the controllers, but the log's estimate is that of fleets.{own[0]}.estimator, "
            f"which runs along; --set fleets.{own[0]}.estimator=null logs yours"
        )

    return Pilot(simulation, policy, estimator, policy_ticks)


def _record(simulation: Simulation, ticks: int, pilot: Flyer | None, once: bool = False) -> Iterator[History]:
    """Fly ``ticks`` ticks, fewer if user functions are slow; yield their states. ``once``: call the pilot once only."""
    capacity = max(ticks, CHUNK_TICKS)
    if pilot is None:
        yield simulation.record(ticks, capacity=capacity)
        return
    end, until = simulation.tick + ticks, time.perf_counter() + (0.0 if once else CHUNK_S)
    while simulation.tick < end:
        yield pilot.record(end - simulation.tick, capacity)
        if time.perf_counter() > until:
            return


def make_parent(folder: Path) -> None:
    """Create the parent of the run folder, early, so that errors show before anything is compiled.

    Raises:
        RunError: it cannot be made or written to.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise RunError(f"cannot create the run folder {folder}: Not a directory: {folder.parent}") from None
    except OSError as error:
        raise RunError(f"cannot create the run folder {folder}: {error.strerror or error}") from None
    if not os.access(folder.parent, os.W_OK):
        raise RunError(f"cannot create the run folder {folder}: {folder.parent} is not writable")


def _loop(
    simulation: Simulation,
    ticks: int,
    begun: tuple[float, float],
    realtime: bool,
    pilot: Flyer | None,
    keep: Callable[[History], None],
    progress: Callable[[float, float], None],
    schedule: Schedule,
    view: Watcher | None = None,
    chunk: int = CHUNK_TICKS,
) -> Pace:
    """Fly until tick ``ticks`` in chunks, in real time or faster, pass each to ``keep``, and return the pace."""
    if realtime:
        chunk = max(1, min(CHUNK_TICKS, round(REALTIME_CHUNK_S / simulation.world.time_step)))
    start = time.perf_counter()
    first = simulation.time
    overruns = 0
    while simulation.tick < ticks:
        schedule.make()
        count = schedule.ticks(min(chunk, ticks - simulation.tick))
        # Kept together, because what is done once a chunk takes longer than most policies.
        histories: list[History] = []
        try:
            for history in _record(simulation, count if view is None else view.wait(count), pilot, once=realtime):
                histories.append(history)
        finally:
            # Also where a user's function has failed.
            if histories:
                keep(History.joined(histories))
        flown, wall = simulation.time - first, time.perf_counter() - start
        if realtime and flown > wall:
            time.sleep(flown - wall)
        elif realtime:
            overruns += 1
        progress(simulation.time, time.perf_counter() - start)
    return Pace(simulation.time, simulation.time - first, time.perf_counter() - start, *begun, overruns)
