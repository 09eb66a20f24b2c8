"""Flies a simulation and records it, at full speed or against the wall clock."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from qrsim.apps.run.streams import STREAMS, EventFinder, columns, values
from qrsim.errors import RunError
from qrsim.logs import RunInfo, RunWriter
from qrsim.scenarios.scenario import Scenario
from qrsim.simulation import History, Simulation

CHUNK_TICKS = 50
REALTIME_CHUNK_S = 0.1


@dataclass(frozen=True)
class Pace:
    """How a recording went.

    Attributes:
        simulated_s: simulated time.
        timed_s: the part of it that ``wall_s`` measures: all but the first tick.
        wall_s: wall time of the flight, without start-up and the first tick.
        start_up_s: wall time until the first tick was done, from the call of ``fly``.
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


def fly(
    scenario: Scenario,
    folder: Path,
    *,
    seed: int,
    precision: str,
    realtime: bool = False,
    progress: Callable[[float, float], None] = lambda simulated_s, wall_s: None,
    command_line: Sequence[str] | None = None,
) -> Pace:
    """Fly a scenario from start to end and record every tick.

    Args:
        scenario: what to fly.
        folder: the run folder; must not exist.
        seed: of all randomness.
        precision: float32 or float64.
        realtime: pace the flight against the wall clock.
        progress: called after every chunk with simulated and wall time [s].
        command_line: words to note in the run folder, by default those of this process.

    Raises:
        UsageError: the folder exists.
        RunError: the log cannot be written; what was flushed before stays readable.
    """
    begun = time.perf_counter()
    simulation = Simulation(scenario.world(precision), seed=seed, name=scenario.name, site=scenario.site)
    info = RunInfo.collect(
        scenario=scenario.name, seed=seed, precision=precision, time_step=scenario.spec.time_step,
        vehicles=simulation.vehicle_names, command_line=command_line,
    )  # fmt: skip
    make_parent(folder)
    simulation.reset()
    beginning, finder = simulation.history, EventFinder(simulation)
    wanted = columns(simulation.world, beginning)
    # The first tick alone, so that compiling does not count as flying.
    first = simulation.record(1, capacity=CHUNK_TICKS)
    start_up, first_tick = time.perf_counter() - begun, time.time()
    gc.enable()
    with RunWriter.create(folder, info=info, scenario_yaml=scenario.to_yaml(), columns=wanted) as writer:

        def keep(history: History) -> None:
            arrays = values(simulation.world, history, wanted)
            with writer.together():
                for stream in STREAMS:
                    writer.append(stream, history.ticks, history.time, arrays[stream])
                for event in finder.find(history):
                    writer.append_event(**event)

        keep(beginning)
        keep(first)
        return _loop(simulation, scenario.ticks, (start_up, first_tick), realtime, keep, progress)


def make_parent(folder: Path) -> None:
    """Make the folder that the run folder goes into, before anything is compiled.

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
    keep: Callable[[History], None],
    progress: Callable[[float, float], None],
) -> Pace:
    chunk = max(1, min(CHUNK_TICKS, round(REALTIME_CHUNK_S / simulation.world.time_step))) if realtime else CHUNK_TICKS
    start = time.perf_counter()
    first = simulation.time
    overruns = 0
    while simulation.tick < ticks:
        keep(simulation.record(min(chunk, ticks - simulation.tick), capacity=CHUNK_TICKS))
        flown, wall = simulation.time - first, time.perf_counter() - start
        if realtime and flown > wall:
            time.sleep(flown - wall)
        elif realtime:
            overruns += 1
        progress(simulation.time, time.perf_counter() - start)
    return Pace(simulation.time, simulation.time - first, time.perf_counter() - start, *begun, overruns)
