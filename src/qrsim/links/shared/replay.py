"""Flies a recorded world of several controllers again: by the orders that its recording says were flown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import RunError, UsageError
from qrsim.links.shared.kinds import NAMES
from qrsim.links.shared.latches import Latches
from qrsim.links.shared.recorded import RESTARTED, STREAM
from qrsim.links.shared.spoken import TICK, Spoken
from qrsim.runs import Run, RunInfo, RunWriter
from qrsim.runs.layout import INJECTIONS_FILE
from qrsim.runs.request_log import RequestLog
from qrsim.runs.streams import EventFinder, Values, columns, values
from qrsim.scenarios.injection_file import read_injections
from qrsim.simulation.history import History
from qrsim.simulation.injections import Injection
from qrsim.simulation.schedule import Schedule
from qrsim.simulation.simulation import Simulation

# Ticks that are flown in one call, where their orders are the same.
MOST_AT_ONCE = 50


def replay(run: Run, out: Path) -> Path:
    """Fly the recorded orders of a run again, record that as another run in ``out``, and return its folder.

    Args:
        run: of a server of a shared world, of MAVLink or of ROS 2.
        out: the new run folder; must not exist.

    Raises:
        UsageError: the run has no orders, is of other vehicles than its scenario has, or the folder exists.
        RunError: a part is damaged or missing, or the new run cannot be written.
    """
    if STREAM not in run:
        raise UsageError(
            f"{run.folder}: it has no orders; --record of 'qrsim mavlink', 'qrsim ros2' and 'qrsim serve SCENARIO "
            "--pace free' (or barrier) records them, and 'qrsim run scenario.yaml' flies the scenario of any other run "
            "again"
        )
    scenario, injections = run.built(), tuple[Injection, ...]()
    if run.injections:
        scenario, injections = read_injections(scenario, run.folder / INJECTIONS_FILE)
    simulation = Simulation(
        scenario.world(run.info.precision), seed=run.info.seed, name=scenario.name, site=scenario.site, number=0
    )
    if simulation.vehicle_names != tuple(run.vehicles):
        raise RunError(f"{run.folder}: its vehicles are not those of its scenario.yaml")
    simulation.reset()
    beginning, finder = simulation.history, EventFinder(simulation)
    # Those of the orders are written as they are read.
    known = columns(simulation.world, beginning)
    orders = [run[STREAM].column(name) for name in run[STREAM].columns()]
    info = RunInfo.of_flight(scenario, simulation)
    with RunWriter.create(out, info=info, scenario_yaml=run.scenario_yaml, columns=known | {STREAM: orders}) as writer:
        schedule = Schedule(simulation, injections)
        requests = RequestLog(simulation, writer.note_injection, writer.append_event)
        for history, flown in _flights(run, simulation, beginning, schedule):
            with writer.together():
                requests.write_new()
                for stream, arrays in (values(simulation.world, history, known) | {STREAM: flown}).items():
                    writer.append(stream, history.ticks, history.time, arrays)
                for event in finder.find(history):
                    writer.append_event(**event)
    return out


def put_back(simulation: Simulation, begins: NumpyArray, row: int) -> None:
    """Put the vehicle at ``row`` back to its start state, a row of ``begins`` (n, 13), with a new battery.

    Args:
        simulation: in flight.
        begins: (n, 13) states of the vehicles at the start.
        row: number of the vehicle.

    Raises:
        UsageError: it cannot be there, because another vehicle is.
    """
    rows = np.full_like(begins, np.nan)
    rows[row] = begins[row]
    simulation.set_state(rows, new_battery=True)


def _flights(
    run: Run, simulation: Simulation, beginning: History, schedule: Schedule
) -> Iterator[tuple[History, Values]]:
    """Fly a run's recorded orders again; yield (states, recorded orders) of each part of the flight."""
    latches, begins = Latches(simulation.world.fleets, simulation.dtype), np.array(simulation.truth.state)
    # Recordings of versions without radio lack these columns.
    spoken = Spoken(simulation) if simulation.world.radio is not None and TICK in run[STREAM].columns() else None
    for batch in run[STREAM].batches():
        first = 0
        if batch.tick[0] == 0:
            yield beginning, {name: array[:1] for name, array in batch.arrays.items()}
            first = 1
        for begin, end in _same_orders(batch.arrays, first, len(batch.tick)):
            if batch.tick[begin] != simulation.tick + 1:
                raise RunError(f"{run.folder}: tick {simulation.tick + 1} is missing in its stream '{STREAM}'")
            latches.codes[...] = batch.arrays["kind"][begin]
            if latches.codes.max(initial=0) > len(NAMES):
                raise RunError(f"{run.folder}: its orders are of a kind that this qrsim does not know")
            # Recordings of versions without lines and circles have fewer numbers.
            latches.numbers[...] = np.nan
            for i in range(latches.numbers.shape[1]):
                if f"number_{i}" in batch.arrays:
                    latches.numbers[:, i] = batch.arrays[f"number_{i}"][begin]
            if RESTARTED.name in batch.arrays:
                for row in np.flatnonzero(batch.arrays[RESTARTED.name][begin] == simulation.tick).tolist():
                    put_back(simulation, begins, row)
            if spoken is not None:
                spoken.read(batch.arrays, begin)
                spoken.say_again(simulation)
            actions = latches.actions()
            while begin < end:
                schedule.make()
                until = begin + schedule.ticks(end - begin)
                history = simulation.record(until - begin, actions, MOST_AT_ONCE)
                yield history, {name: array[begin:until] for name, array in batch.arrays.items()}
                begin = until


def _same_orders(arrays: Mapping[str, NumpyArray], first: int, count: int) -> Iterator[tuple[int, int]]:
    """Yield (begin, end) of stretches of ticks with equal orders, so that one call flies each stretch.

    Radio messages are sent and vehicles are put back ahead of the first tick of a run only.

    Args:
        arrays: columns (T, ...) of the recorded orders.
        first, count: rows ``first`` to ``count`` - 1 are divided, into at most ``MOST_AT_ONCE`` each.
    """
    # NaN marks numbers that an order lacks. A new message, and a vehicle put back, has a new tick in its column.
    ticks = (TICK, RESTARTED.name)
    names = ["kind", *(name for name in arrays if name.startswith("number_") or name in ticks)]
    rows = np.concatenate([np.asarray(arrays[name], np.float64) for name in names], axis=1)
    same = np.zeros(count, bool)
    same[1:] = ((rows[1:] == rows[:-1]) | (np.isnan(rows[1:]) & np.isnan(rows[:-1]))).all(axis=1)
    while first < count:
        end = first + 1
        while end < count and same[end] and end - first < MOST_AT_ONCE:
            end += 1
        yield first, end
        first = end
