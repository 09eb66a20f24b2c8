"""Scores on held-out data: prediction errors, and whiteness of the residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import scipy

from qrsim.errors import UsageError
from qrsim.files import Content
from qrsim.studies.flight_logs import FlightLog
from qrsim.studies.flight_logs.signals import Floats
from qrsim.studies.identify.constants import VELOCITY, vehicle_of
from qrsim.studies.identify.problem import Piece, Shooting, cut

LAGS = 20
HORIZON_S = 5.0


def open_loop(piece: Piece, values: Mapping[str, float], nuisances: Mapping[str, float], separate: bool) -> Floats:
    """Simulate channels (R, n, C) of windows open loop from recorded first rows; ``separate``: pitch unlike roll."""
    shooting = Shooting(piece, vehicle_of(dict(values), separate))
    return shooting.simulated(nuisances)


def mean_square(piece: Piece, simulated: Floats) -> dict[str, float]:
    """Return channel -> mean squared error of a simulation (R, n, C); infinite if it diverged."""
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.square(simulated - piece.recorded)[piece.used].mean(axis=0)
    return dict(zip(piece.channels, np.nan_to_num(error, nan=np.inf, posinf=np.inf).tolist(), strict=True))


def score(
    log: FlightLog,
    share: tuple[float, float],
    start: Mapping[str, float],
    identified: Mapping[str, float],
    nuisances: Mapping[str, float],
    separate: bool,
) -> dict[str, object]:
    """Return open-loop errors on a ``share`` of a log with constants before and after the fit, restarted after gaps.

    The constants at the start have the same delay, once with neither wind nor trims and once with those of the fit.

    Args:
        log: what was read.
        share: first and last share of its rows.
        start: the constants before.
        identified: the constants after.
        nuisances: of this log, from its training part.
        separate: pitch has constants of its own.
    """
    piece = cut(log, math.inf, *share)
    bare = {"delay": nuisances["delay"]}
    cases = {"start": (start, bare), "start_with_nuisances": (start, nuisances), "identified": (identified, nuisances)}
    runs = {name: open_loop(piece, values, own, separate) for name, (values, own) in cases.items()}
    result: Content = {
        "rows": int(piece.used.sum()),
        "variance": dict(zip(piece.channels, np.var(piece.recorded[piece.used], axis=0).tolist(), strict=True)),
        **{name: mean_square(piece, run) for name, run in runs.items()},
    }
    result["lower_percent"] = lower(result["start"], result["identified"])
    if set(VELOCITY) <= set(piece.channels):
        result["velocity_5_s"] = _velocity_error(log, share, cases, separate)
    return result


def lower(before: Mapping[str, float], after: Mapping[str, float]) -> dict[str, float]:
    """Return by how much [%] each error fell from ``before`` to ``after``; errors of 0 or infinity are left out."""
    names = [name for name in before if before[name] > 0.0 and math.isfinite(before[name] + after[name])]
    return {name: 100.0 * (1.0 - after[name] / before[name]) for name in names}


def _velocity_error(
    log: FlightLog,
    share: tuple[float, float],
    cases: Mapping[str, tuple[Mapping[str, float], Mapping[str, float]]],
    separate: bool,
) -> Content:
    """Return mean squared errors of the horizontal velocity [(m/s)^2] in 5 s windows, for each case of constants."""
    try:
        piece = cut(log, HORIZON_S, *share, whole=True)
    except UsageError:
        return {}
    result = {}
    for name, (values, own) in cases.items():
        errors = mean_square(piece, open_loop(piece, values, own, separate))
        result[name] = errors["velocity_north"] + errors["velocity_east"]
    still = np.broadcast_to(piece.recorded[:1], piece.recorded.shape)
    errors = mean_square(piece, still)
    result["no_change"] = errors["velocity_north"] + errors["velocity_east"]
    result["pieces"] = piece.windows.shape[1]
    if not all(math.isfinite(each) and each > 0.0 for each in (result[name] for name in cases)):
        return {}
    result["lower_percent"] = 100.0 * (1.0 - result["identified"] / result["start"])
    result["lower_percent_with_nuisances"] = 100.0 * (1.0 - result["identified"] / result["start_with_nuisances"])
    return result


def whiteness(piece: Piece, residuals: Floats) -> dict[str, dict[str, float]]:
    """Test the residuals (R, n, C) of each channel for whiteness; return channel -> statistics.

    ``lag_1``: autocorrelation of neighbouring rows; ``correlated_s``: time over which the autocorrelation falls to
    1/e; ``ljung_box_p``: probability of so much correlation within 20 rows in white noise; ``input``: largest
    correlation with a command up to 20 rows earlier, which is motion that the model's form leaves out.
    """
    result = {}
    commands = piece.commands[piece.windows]
    for c, name in enumerate(piece.channels):
        r = np.where(piece.used, residuals[:, :, c] - residuals[:, :, c][piece.used].mean(), 0.0)
        correlations = _correlations(r, r)
        count, lags = int(piece.used.sum()), np.arange(1, len(correlations))
        box = count * (count + 2) * float(np.sum(correlations[1:] ** 2 / np.maximum(count - lags, 1)))
        below = np.flatnonzero(correlations < 1.0 / math.e)
        largest = 0.0
        for k in range(commands.shape[2]):
            u = commands[:, :, k] - commands[:, :, k][piece.used].mean()
            if np.std(u[piece.used]) > 1e-9:
                largest = max(largest, float(np.abs(_correlations(np.where(piece.used, u, 0.0), r)).max()))
        result[name] = {
            "lag_1": float(correlations[1]) if len(correlations) > 1 else 0.0,
            "correlated_s": float(below[0] if len(below) else len(correlations)) * piece.log.dt,
            "ljung_box_p": float(scipy.stats.chi2.sf(box, max(len(lags), 1))),
            "input": largest,
        }
    return result


def _correlations(first: Floats, second: Floats) -> Floats:
    """Return correlations (L,) of ``first`` with ``second`` 0 to ``LAGS`` rows later; 1 for equal series.

    Both are (R, n), of mean zero, with 0 in unused rows. The lag runs along R, so that no window is compared with
    another.
    """
    length = max(min(LAGS, len(first) - 2), 0)
    scale = math.sqrt(float(np.sum(first**2)) * float(np.sum(second**2))) or 1.0
    sums = [float(np.sum(first[: len(first) - lag] * second[lag:])) for lag in range(length + 1)]
    return np.array(sums) / scale
