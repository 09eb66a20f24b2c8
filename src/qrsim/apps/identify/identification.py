"""From logs to an identified vehicle."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from qrsim.apps.identify.constants import check_names, constants_in, needed_for
from qrsim.apps.identify.fit import Question, solve
from qrsim.apps.identify.problem import cut
from qrsim.apps.identify.result import Result
from qrsim.apps.identify.scores import score, whiteness
from qrsim.core.tree import replace
from qrsim.errors import UsageError
from qrsim.flight_logs import FlightLog

HORIZON_S, TRAIN = 5.0, 0.6


def identify(
    logs: Sequence[FlightLog],
    question: Question,
    horizon: float = HORIZON_S,
    train: float = TRAIN,
    progress: Callable[[str], None] = lambda text: None,
) -> Result:
    """Fit the first share ``train`` of each log and score the rest; nothing of the rest is used before.

    Args:
        logs: what was read.
        question: what is to be estimated; no constants named means all that the logs can show.
        horizon: length of a window of multiple shooting [s].
        train: share of the rows.
        progress: is told what happens.

    Raises:
        UsageError: the logs lack a signal for a constant that was asked for, are too short, or determine nothing.
    """
    begun = time.perf_counter()
    pieces = [cut(log, horizon, 0.0, train) for log in logs]
    shown = {name: None for piece in pieces for name in constants_in(piece.channels, question.separate)}
    if question.constants:
        check_names(question.constants, question.separate)
        flown = any("velocity_down" in piece.channels for piece in pieces)
        for name in question.constants:
            if name not in shown and not (name == "mass" and flown):
                logs[0].require(needed_for(name), f"'{name}'")
                raise UsageError(f"{logs[0].source}: nothing in it depends on '{name}'; constants: {', '.join(shown)}")
        names = question.constants
    else:
        # The mass is not to be told from the scale of the thrust unless something is known of it.
        names = (*shown, *(name for name in ("mass",) if name in question.priors and "kw" in shown))
    question = replace(question, constants=tuple(names))
    answer = solve(question, pieces, progress)
    scores = [
        score(log, (train, 1.0), question.start, answer.values, answer.nuisances[i], question.separate)
        for i, log in enumerate(logs)
    ]
    white = [whiteness(piece, answer.residuals[i]) for i, piece in enumerate(pieces)]
    return Result(question, answer, pieces, scores, white, time.perf_counter() - begun, train)


def part_of(log: FlightLog, first: float, last: float) -> FlightLog:
    """Return the rows of a log from ``first`` to ``last`` [s].

    Raises:
        UsageError: nothing is left.
    """
    if first <= 0.0 and math.isinf(last):
        return log
    rows = (log.time >= first - 1e-9) & (log.time <= last + 1e-9)
    if rows.sum() < 2:
        raise UsageError(f"{log.source}: no rows from {first:g} to {last:g} s; it has 0 to {log.time[-1]:g} s")
    notes = [*log.notes, f"rows from {log.time[rows][0]:.2f} to {log.time[rows][-1]:.2f} s only"]
    signals = {name: values[rows] for name, values in log.signals.items()}
    return replace(log, time=log.time[rows] - log.time[rows][0], signals=signals, notes=notes)
