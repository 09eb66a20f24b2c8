"""When something happened in a run, to show several runs from the same moment."""

from __future__ import annotations

import numpy as np

from qrsim.errors import UsageError, did_you_mean
from qrsim.runs import Run
from qrsim.runs.layout import EVENTS
from qrsim.runs.summary import NOT_A_STOP

# Words that are not kinds of events.
TAKE_OFF, STOP = "take-off", "stop"
# Without an event, a vehicle has taken off this far above its start [m].
OFF_M = 0.5


def shift_of(runs: list[Run], align: str) -> list[float]:
    """Return the delay [s] with which to show each run, so that its event ``align`` coincides with the first run's.

    Args:
        runs: of which the first is not shifted.
        align: TAKE_OFF, STOP (the first vehicle that stopped) or the kind of an event; the first of a run counts.

    Raises:
        UsageError: a run has no such event; the message lists those that it has.
    """
    times = [_time_of(run, align) for run in runs]
    return [times[0] - time for time in times]


def _time_of(run: Run, align: str) -> float:
    """Return the time [s] of the first event of the kind ``align`` in a run; raise UsageError if it has none."""
    events = run.events if EVENTS in run else []
    kinds = {event.kind: event.time for event in reversed(events)}
    stops = [event.time for event in events if event.kind not in NOT_A_STOP and event.vehicle]
    known = {**kinds, **({STOP: stops[0]} if stops else {})}
    took_off = kinds.get("took_off", _off_ground(run) if align == TAKE_OFF else None)
    if took_off is not None:
        known[TAKE_OFF] = took_off
    if align in known:
        return known[align]
    names = [*dict.fromkeys([*known, TAKE_OFF, STOP])]
    if align in (TAKE_OFF, STOP):
        what = "no vehicle takes off" if align == TAKE_OFF else "no vehicle stops"
        raise UsageError(f"--align {align}: {what} in {run.folder}; events in it: {', '.join(kinds) or 'none'}")
    guess = did_you_mean(align, names)
    raise UsageError(f"--align {align}: no such event in {run.folder}{guess or f'; known: {chr(44).join(names)}'}")


def _off_ground(run: Run) -> float | None:
    """Return the time [s] at which the first vehicle that began at rest is OFF_M above its start; None if never."""
    truth = run["truth"]
    names = ("position_ned.z", *(f"velocity_body.{axis}" for axis in "xyz"))
    if any(name not in truth for name in names):
        return None
    down = truth["position_ned.z"]
    speed = np.sqrt(sum(truth[name][0].astype(float) ** 2 for name in names[1:]))
    rows = np.flatnonzero(((down[:1] - down > OFF_M) & (speed < OFF_M)).any(axis=1))
    return float(truth.time[rows[0]]) if len(rows) else None
