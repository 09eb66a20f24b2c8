"""From logs to an identified vehicle."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from qrsim.core.tree import replace
from qrsim.errors import RunError, UsageError
from qrsim.studies.flight_logs import FlightLog
from qrsim.studies.flight_logs.excitation import ON_THE_GROUND, measure, standing_still, without_frozen, without_ground
from qrsim.studies.identify.constants import channels_of, check_names, constants_in, needed_for
from qrsim.studies.identify.fit import Answer, Question, solve
from qrsim.studies.identify.problem import Piece, cut
from qrsim.studies.identify.result import Result
from qrsim.studies.identify.scores import score, whiteness
from qrsim.studies.identify.verdicts import (
    not_shown,
    objections,
    refuse_unexcited,
    refuse_useless,
    verdicts_of,
    worse,
)

HORIZON_S, TRAIN = 5.0, 0.6
# With fewer windows nothing tells how an estimate differs from one part of a log to the next.
FEWEST_WINDOWS, SHORTEST_WINDOW_S = 4, 0.5


def identify(
    logs: Sequence[FlightLog],
    question: Question,
    horizon: float = HORIZON_S,
    train: float = TRAIN,
    progress: Callable[[str], None] = lambda text: None,
) -> Result:
    """Fit constants to the first fraction ``train`` of each log; score them on the rest, which can only reject some.

    Args:
        logs: what was read.
        question: what is to be estimated; no constants named means all that the logs can show.
        horizon: length of a window of multiple shooting [s].
        train: share of the rows.
        progress: is told what happens.

    Raises:
        LogError: the logs lack a signal for a constant that was asked for, are too short, or show no constant.
        UsageError: a constant that was asked for is not known.
        RunError: no fit predicts the held-out parts better than the start does.
    """
    begun = time.perf_counter()
    logs = [_flight_rows(log, question, progress) for log in logs]
    for log in logs:
        cut(log, math.inf, train, 1.0)  # refuses at once a log with nothing to score
    pieces = _training_pieces(logs, horizon, train, progress)
    question = replace(question, constants=_selected_constants(question, pieces))
    excitations = [measure(piece.log, piece.rows) for piece in pieces]
    pieces = [
        replace(piece, silent=tuple(name for name in each.silent if name in piece.channels))
        for piece, each in zip(pieces, excitations, strict=True)
    ]
    held = not_shown(question.constants, question.separate, excitations)
    if set(held) == set(question.constants):
        refuse_unexcited(logs, excitations, held)
    for name, why in held.items():
        progress(f"{name}: held at its start: {why}")
    while True:
        question = replace(question, held=tuple(held))
        answer = _solve(question, pieces, progress)
        scores = _held_out_scores(question, answer, logs, train)
        hold, doubtful = worse(answer, question, excitations, scores)
        found = objections(answer, question) or hold
        if not found:
            break
        held |= found
        for name, why in found.items():
            progress(f"{name}: held at its start: {why}")
        if set(held) == set(question.constants):
            refuse_useless(logs, held)
    white = [whiteness(piece, answer.residuals[i]) for i, piece in enumerate(pieces)]
    return Result(
        question,
        answer,
        pieces,
        scores,
        white,
        time.perf_counter() - begun,
        train,
        verdicts_of(answer, question, held, doubtful),
        excitations,
    )


def _selected_constants(question: Question, pieces: Sequence[Piece]) -> tuple[str, ...]:
    """Return the names of the requested constants, or of all that the logs' signals depend on."""
    shown = {name: None for piece in pieces for name in constants_in(piece.channels, question.separate)}
    if not question.constants:
        # The mass is not to be told from the scale of the thrust unless something is known of it.
        return (*shown, *(name for name in ("mass",) if name in question.priors and "kw" in shown))
    check_names(question.constants, question.separate)
    flown = any("velocity_down" in piece.channels for piece in pieces)
    first = pieces[0].log
    for name in question.constants:
        if name not in shown and not (name == "mass" and flown):
            first.require(needed_for(name), f"'{name}'")
            raise UsageError(f"{first.source}: nothing in it depends on '{name}'; constants: {', '.join(shown)}")
    return question.constants


def _flight_rows(log: FlightLog, question: Question, progress: Callable[[str], None]) -> FlightLog:
    """Return a log without rows on the ground and without values of frozen sensors.

    Raises:
        LogError: it stands there nearly all the time.
    """
    if standing_still(log).mean() >= ON_THE_GROUND:
        excitation = measure(log, np.ones(len(log.time), bool))
        names = question.constants or constants_in(channels_of(log), question.separate)
        refuse_unexcited([log], [excitation], not_shown(names, question.separate, [excitation]))
    flown = without_frozen(without_ground(log))
    for note in flown.notes[len(log.notes) :]:
        progress(f"{flown.source}: {note}")
    return flown


def _training_pieces(
    logs: Sequence[FlightLog], horizon: float, train: float, progress: Callable[[str], None]
) -> list[Piece]:
    """Cut the training part of each log into windows of ``horizon`` [s], shorter if they would be too few."""
    pieces = [cut(log, horizon, 0.0, train) for log in logs]
    if sum(piece.windows.shape[1] for piece in pieces) >= FEWEST_WINDOWS:
        return pieces
    seconds = sum(int(piece.used.sum()) * piece.log.dt for piece in pieces)
    shorter = max(SHORTEST_WINDOW_S, seconds / FEWEST_WINDOWS)
    if shorter >= horizon:
        return pieces
    progress(f"windows of {shorter:.2f} s instead of {horizon:g} s, because {seconds:.1f} s are fitted")
    return [cut(log, shorter, 0.0, train) for log in logs]


def _solve(question: Question, pieces: Sequence[Piece], progress: Callable[[str], None]) -> Answer:
    """Solve the fit; raises RunError that names the logs if it has no solution."""
    try:
        return solve(question, pieces, progress)
    except (np.linalg.LinAlgError, FloatingPointError) as error:
        named = ", ".join(str(piece.log.source) for piece in pieces)
        raise RunError(f"{named}: the equations of the fit have no solution ({error}); nothing is written") from None


def _held_out_scores(
    question: Question, answer: Answer, logs: Sequence[FlightLog], train: float
) -> list[dict[str, object]]:
    """Return the scores of the fitted constants on each log's rest after the fraction ``train``."""
    return [
        score(log, (train, 1.0), question.start, answer.values, answer.nuisances[i], question.separate)
        for i, log in enumerate(logs)
    ]


def part_of(log: FlightLog, first: float, last: float) -> FlightLog:
    """Return a log with only the rows from time ``first`` to ``last`` [s].

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
