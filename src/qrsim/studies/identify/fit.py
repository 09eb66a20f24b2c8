"""Non-linear least squares over the constants and the nuisances of each log."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from qrsim.errors import LogError
from qrsim.studies.flight_logs.signals import Floats
from qrsim.studies.identify.constants import NUISANCES, bounds_of, vehicle_of
from qrsim.studies.identify.intervals import Covariance, covariance
from qrsim.studies.identify.pace import Pace
from qrsim.studies.identify.problem import ROBUST_AT, Misfit, Piece, Shooting, weights

Progress = Callable[[str], None]
# Rounds in which the noise of each channel is estimated anew from what the fit leaves.
ROUNDS = 4
NOISE_TOLERANCE = 0.05
# A constant whose interval reaches further than this share of its weak prior's standard deviation is not identified.
LARGEST_HALF_WIDTH = 0.5
# Constants that may be near zero count by what they add: a fifth of the thrust of hovering [N, N/raw].
SMALLEST_WIDTH = {"cth0": 3.3, "cth1": 1.4e-3}
# Correlation of two estimates from which on one is not to be told from the other.
COMBINED = 0.8
# A standard deviation beside which nothing counts.
IGNORED_NOISE = 1e6
# One below which a fit is as exact as its arithmetic.
SMALLEST_NOISE = 1e-6
DELAY_STEP_S, LONGEST_DELAY_S = 0.02, 0.7


@dataclass(frozen=True)
class Prior:
    """A normal distribution of a constant."""

    mean: float
    std: float


@dataclass(frozen=True)
class Question:
    """The estimation problem.

    Attributes:
        constants: names, in the order of the result.
        start: every constant of the vehicle by name, where the search begins.
        separate: pitch has constants of its own.
        priors: of constants.
        delay: [s] given for all logs; None: estimated for each.
        robust: soft_l1 rather than plain squares.
        ignored: measured signals that count for nothing, because they are known to be wrong.
        held: of the constants those that stay at their start.
    """

    constants: tuple[str, ...]
    start: Mapping[str, float]
    separate: bool = False
    priors: Mapping[str, Prior] = field(default_factory=dict)
    delay: float | None = None
    robust: bool = True
    ignored: tuple[str, ...] = ()
    held: tuple[str, ...] = ()


@dataclass(frozen=True)
class Answer:
    """The estimates.

    Attributes:
        values: every constant of the vehicle by name.
        estimated: names of those that the logs determine.
        left: the others that were fitted, with the reason in words; their values are held by their priors.
        nuisances: of each log by name.
        covariance: of estimated constants and nuisances.
        noise: of each log, standard deviation of each channel.
        residuals: of each log, recorded minus simulated over the noise, (R, n, C), 0 where a row does not count.
        at_bounds: estimated constants that ended at a bound.
        evaluations: of the residuals with their derivatives.
    """

    values: dict[str, float]
    estimated: tuple[str, ...]
    left: dict[str, str]
    nuisances: list[dict[str, float]]
    covariance: Covariance
    noise: list[dict[str, float]]
    residuals: list[Floats]
    at_bounds: tuple[str, ...]
    evaluations: int


class _Sum:
    """The residuals of all logs as a function of one vector of scaled unknowns."""

    def __init__(self, question: Question, pieces: Sequence[Piece]):
        self.question = question
        self.constants = constants = tuple(name for name in question.constants if name not in question.held)
        vehicle = vehicle_of(dict(question.start), question.separate)
        self.shootings = [Shooting(piece, vehicle, question.robust) for piece in pieces]
        self.free = [tuple(name for name in piece.nuisances if not self._is_given(name)) for piece in pieces]
        self.names = (*constants, *(f"{name}@{i}" for i, free in enumerate(self.free) for name in free))
        scales = {name: abs(question.start[name]) or 1.0 for name in constants}
        self.scale = np.array([scales.get(name) or NUISANCES[name.partition("@")[0]].scale for name in self.names])
        self.robust = question.robust
        self.evaluations = 0
        self.pace: Pace | None = None
        self._last: tuple[object, list[Misfit]] | None = None

    def be_robust(self, robust: bool) -> None:
        """Choose a robust or a plain square loss of residuals, in flight and in the initial states of windows."""
        self.robust, self._last = robust, None
        for shooting in self.shootings:
            shooting.robust = robust

    def _is_given(self, name: str) -> bool:
        """Return whether the user fixed this unknown (the delay), so that it is not estimated."""
        return name == "delay" and self.question.delay is not None

    def bounds(self) -> tuple[Floats, Floats]:
        """Return the (lower, upper) bounds, (K,) each, of the K scaled unknowns."""
        each = [
            bounds_of(name, self.question.start[name])
            if "@" not in name
            else (NUISANCES[name.partition("@")[0]].low, NUISANCES[name.partition("@")[0]].high)
            for name in self.names
        ]
        low, high = np.array(each).T
        return low / self.scale, high / self.scale

    def first(self) -> Floats:
        """Return the initial values (K,) of the K scaled unknowns."""
        return np.array([self.question.start.get(name, 0.0) for name in self.names]) / self.scale

    def of_log(self, unknowns: Floats, i: int) -> dict[str, float]:
        """Return name -> value of all that simulating log ``i`` needs: constants and the log's nuisance parameters.

        What is held is among them, so that the compiled simulation is the same whatever is.
        """
        values = dict(zip(self.names, (unknowns * self.scale).tolist(), strict=True))
        own = {name: values.get(f"{name}@{i}", 0.0) for name in self.shootings[i].piece.nuisances}
        if self.question.delay is not None:
            own["delay"] = self.question.delay
        return {name: values.get(name, self.question.start[name]) for name in self.question.constants} | own

    def evaluate(self, unknowns: Floats, noise: Sequence[Mapping[str, float]]) -> list[Misfit]:
        """Return the misfit of each log with derivatives by the K scaled unknowns; ``noise`` is by log and channel."""
        now = (unknowns.tolist(), [dict(scale) for scale in noise], [each.gust.tolist() for each in self.shootings])
        if self._last is not None and self._last[0] == now:
            return self._last[1]
        misfits = []
        for i, shooting in enumerate(self.shootings):
            misfit = shooting.misfit(values := self.of_log(unknowns, i), noise[i])
            place = {name: k for k, name in enumerate(values)}
            own = [place.get(name if "@" not in name else self._name_in_log(name, i), -1) for name in self.names]

            def spread(by_value: Floats, own: list[int] = own) -> Floats:
                """Expand derivatives by one log's values to derivatives by all scaled unknowns."""
                padded = np.concatenate([by_value, np.zeros((*by_value.shape[:-1], 1))], axis=-1)
                return padded[..., own] * self.scale

            misfits.append(
                misfit._replace(by_value=spread(misfit.by_value), gust_by_value=spread(misfit.gust_by_value))
            )
        self.evaluations += 1
        if self.pace is not None:
            self.pace.step()
        self._last = now, misfits
        return misfits

    def _name_in_log(self, name: str, i: int) -> str:
        """Return the plain name of unknown "name@i", a nuisance of log ``i``; "" if it is of another log."""
        base, _, log = name.partition("@")
        return base if int(log) == i else ""

    def prior(self, unknowns: Floats) -> tuple[Floats, Floats]:
        """Return the residuals of the priors, and their derivatives by the scaled unknowns."""
        rows, targets = [], []
        for k, name in enumerate(self.names):
            known = self.question.priors.get(name)
            if known is None and "@" in name and not name.startswith("delay@"):
                known = Prior(0.0, NUISANCES[name.partition("@")[0]].scale * 10.0)
            elif known is None and "@" not in name:
                known = Prior(self.question.start[name], width_of(name, self.question))
            if known is not None:
                row = np.zeros(len(self.names))
                row[k] = self.scale[k] / known.std
                rows.append(row)
                targets.append(known.mean / known.std)
        matrix = np.array(rows).reshape(-1, len(self.names))
        return matrix @ unknowns - np.array(targets), matrix


def width_of(name: str, question: Question) -> float:
    """Return the default standard deviation of a constant's prior: the magnitude of its initial value."""
    return max(abs(question.start[name]), SMALLEST_WIDTH.get(name, 0.0))


def solve(question: Question, pieces: Sequence[Piece], progress: Progress = lambda text: None) -> Answer:
    """Fit all constants of a model to windows of logs; constants that the logs do not determine stay near their prior.

    Raises:
        LogError: no constant at all shows in the logs.
    """
    total = _Sum(question, pieces)
    seconds = sum(float(piece.used.sum()) * piece.log.dt for piece in pieces)
    total.pace = Pace(seconds, len(total.names), progress, first=not question.held)
    unknowns, noise = total.first(), [_first_noise(piece, question.ignored) for piece in pieces]
    if question.delay is None:
        unknowns = _search_delays(total, unknowns, noise)
    unknowns, noise = _alternate(total, unknowns, noise, progress)
    answer = _answer(total, unknowns, noise)
    # Constants whose intervals are wide are told as such; only a log that nothing shows in is refused.
    if not (answer.covariance.information[: len(total.constants)] > 0.0).any():
        reasons = "; ".join(f"{name}: {why}" for name, why in answer.left.items())
        raise LogError(f"{pieces[0].log.source}: no constant can be identified; {reasons}")
    return answer


def _first_noise(piece: Piece, ignored: Sequence[str]) -> dict[str, float]:
    """Return channel -> first guess of its noise: half of its standard deviation within the windows."""
    recorded = np.where(piece.used[:, :, None], piece.recorded, np.nan)
    spread = np.sqrt(np.nanmean(np.nanvar(recorded, axis=0), axis=0))
    named = zip(piece.channels, spread.tolist(), strict=True)
    unused = {*ignored, *piece.silent}
    return {name: IGNORED_NOISE if name in unused else max(0.5 * size, SMALLEST_NOISE) for name, size in named}


def _search_delays(total: _Sum, unknowns: Floats, noise: list[dict[str, float]]) -> Floats:
    """Return the unknowns with each log's delay set by a grid search, because the cost has many minima in it."""
    unknowns = unknowns.copy()
    for i, shooting in enumerate(total.shootings):
        if f"delay@{i}" not in total.names:
            continue
        place = total.names.index(f"delay@{i}")
        costs = {}
        for delay in np.arange(0.0, LONGEST_DELAY_S + 1e-9, DELAY_STEP_S):
            shooting.starts = shooting.piece.starts()
            values = total.of_log(unknowns, i) | {"delay": float(delay)}
            scale = np.array([noise[i][name] for name in shooting.piece.channels])
            residual = (shooting.simulated(values) - shooting.piece.recorded) * shooting.piece.used[:, :, None] / scale
            costs[float(delay)] = float(np.sum(np.square(np.clip(np.nan_to_num(residual, nan=1e3), -1e3, 1e3))))
        unknowns[place] = min(costs, key=lambda delay: costs[delay]) / total.scale[place]
    return unknowns


def _alternate(
    total: _Sum, unknowns: Floats, noise: list[dict[str, float]], progress: Progress
) -> tuple[Floats, list[dict[str, float]]]:
    """Estimate in turns the unknowns and the noise of each channel until the noise converges; return both."""
    low, high = total.bounds()
    for number in range(ROUNDS):
        # At first plain squares: far from the optimum the robust loss would take for outliers what tells most.
        total.be_robust(total.question.robust and number > 0)
        unknowns = _least_squares(total, np.clip(unknowns, low, high), noise, 1e-4 if number == 0 else 1e-7)
        before = noise
        noise = _channel_noise(total, unknowns, noise)
        for shooting in total.shootings:
            shooting.learn_gust()
        change = max(abs(math.log(b[n] / a[n])) for a, b in zip(before, noise, strict=True) for n in a)
        progress(f"round {number + 1}: noise of the channels changed by up to {100 * math.expm1(change):.1f} %")
        if change < NOISE_TOLERANCE and number > 0:
            break
    return unknowns, noise


def _least_squares(total: _Sum, first: Floats, noise: list[dict[str, float]], tolerance: float) -> Floats:
    """Return the unknowns that minimise the robust sum of squares, starting at ``first``, to a relative tolerance."""
    bounds = total.bounds()
    last: dict[str, Any] = {}

    def both(unknowns: Floats) -> tuple[Floats, Floats]:
        """Return residuals and their Jacobian, cached for the last unknowns."""
        if "at" not in last or not np.array_equal(last["at"], unknowns):
            misfits = total.evaluate(unknowns, noise)
            prior, matrix = total.prior(unknowns)
            rows = [part for each in misfits for part in (each.residual, each.gust)]
            slopes = [part for each in misfits for part in (each.by_value, each.gust_by_value)]
            last["found"] = (
                np.concatenate([*(r.ravel() for r in rows), prior]),
                np.concatenate([*(d.reshape(-1, d.shape[-1]) for d in slopes), matrix]),
            )
            last["at"] = unknowns.copy()
        return last["found"]

    margin = 1e-6 * (bounds[1] - bounds[0])
    return scipy.optimize.least_squares(
        lambda unknowns: both(unknowns)[0],
        np.clip(first, bounds[0] + margin, bounds[1] - margin),
        jac=lambda unknowns: both(unknowns)[1],
        bounds=bounds,
        loss="soft_l1" if total.robust else "linear",
        f_scale=ROBUST_AT,
        x_scale="jac",
        xtol=1e-6,
        ftol=tolerance,
        max_nfev=40,
    ).x


def _channel_noise(total: _Sum, unknowns: Floats, noise: list[dict[str, float]]) -> list[dict[str, float]]:
    """Return, for each log, channel -> standard deviation of its residuals under the robust loss."""
    misfits = total.evaluate(unknowns, noise)
    result = []
    for misfit, scale, shooting in zip(misfits, noise, total.shootings, strict=True):
        residual, count = misfit.residual, shooting.piece.used.sum()
        spread = np.sqrt((np.square(residual) * weights(residual, total.robust)).sum(axis=(0, 1)) / count)
        named = zip(shooting.piece.channels, spread.tolist(), strict=True)
        new = {name: max(scale[name] * max(size, 1e-6), SMALLEST_NOISE) for name, size in named}
        unused = {*total.question.ignored, *shooting.piece.silent}
        result.append(new | {name: IGNORED_NOISE for name in unused if name in new})
    return result


def _unknowns_covariance(
    total: _Sum, unknowns: Floats, noise: list[dict[str, float]]
) -> tuple[Covariance, list[Floats]]:
    """Return the covariance of the unknowns at the solution, and the residuals (R, n, C) of each log."""
    misfits = total.evaluate(unknowns, noise)
    lengths = [len(shooting.piece.windows) * shooting.piece.log.dt for shooting in total.shootings]
    matrix = covariance(
        total.names,
        unknowns * total.scale,
        total.scale,
        misfits,
        lengths,
        total.prior(unknowns)[1],
        total.question.robust,
    )
    return matrix, [each.residual for each in misfits]


def _undetermined(total: _Sum, found: Covariance) -> dict[str, str]:
    """Return constant -> reason, for constants that the logs do not determine."""
    left = {}
    for k, name in enumerate(total.constants):
        # The prior and not the estimate is the measure, and no error smaller than that of white residuals: else those
        # estimates would count as identified that chance has made large or their errors small.
        half = float(found.quantile[k] * max(found.std[k], found.white[k]))
        if found.information[k] <= 0.0:
            left[name] = "nothing in the logs depends on it"
        elif found.lost[k]:
            left[name] = "a single part of the logs shows it, so that it has no interval"
        elif half > LARGEST_HALF_WIDTH * width_of(name, total.question):
            left[name] = (
                f"its 95 % interval is +-{half:.3g}, against {width_of(name, total.question):.3g} of its prior: "
                + (_name_partners(total, found, k) or "too little excitation")
            )
    return left


def _name_partners(total: _Sum, found: Covariance, k: int) -> str:
    """Return in words the constants that unknown number ``k`` cannot be separated from; "" if none."""
    others = [(abs(found.correlation[k, i]), name) for i, name in enumerate(total.constants) if i != k]
    near = [name for size, name in sorted(others, reverse=True)[:2] if size > COMBINED]
    return f"not to be told from {' and '.join(near)}" if near else ""


def _answer(total: _Sum, unknowns: Floats, noise: list[dict[str, float]]) -> Answer:
    """Return the fitted constants and their covariance at the solution ``unknowns``, in scaled units."""
    found, residuals = _unknowns_covariance(total, unknowns, noise)
    left = _undetermined(total, found)
    real = dict(zip(total.names, (unknowns * total.scale).tolist(), strict=True))
    low, high = total.bounds()
    edge = 1e-4 * (high - low)
    at_bounds = tuple(
        name
        for k, name in enumerate(total.constants)
        if unknowns[k] < low[k] + edge[k] or unknowns[k] > high[k] - edge[k]
    )
    own = [
        {name: number for name, number in total.of_log(unknowns, i).items() if name in NUISANCES}
        for i in range(len(total.shootings))
    ]
    values = {**total.question.start, **{name: real[name] for name in total.constants}}
    estimated = tuple(name for name in total.constants if name not in left)
    return Answer(values, estimated, left, own, found, noise, [-r for r in residuals], at_bounds, total.evaluations)
