"""Final selection among the laws of the Pareto fronts, by flights far longer than in evolution.

An error of 0.3 s says little of what adds up over seconds (the gain of a yaw rate, an offset). The constants of each
law of a front are therefore fitted once more, with trims, to windows of 3 s in the first part of the training rows, and
the laws are compared on windows of 10 s, or half of what there is, in the rest of those rows. The smallest law counts
that is not clearly worse than the best, by one standard error of the difference or by 1 %; windows that overlap count
as no more than fit beside each other. How long the windows are that its constants are fitted to, and whether there are
trims, is chosen by the same comparison; at last they are fitted to all training rows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from qrsim.errors import UsageError
from qrsim.studies.discover.evolution import FAILED, Population, Proposal, errors_of, fitted, partners_of
from qrsim.studies.discover.flight import TRIMS, Flight, Floats, fly, windows_of
from qrsim.studies.discover.proposals import rule_of
from qrsim.studies.flight_logs import FlightLog

FIT_S, COMPARE_S, FIRST_PART = (3.0, 10.0), 10.0, 0.6
FEWEST_WINDOWS, REFINEMENTS = 16, 4
# Usual size of a trim [rad, rad/s]: a law with a constant could be written with any trim.
TRIM = 0.02
# A share by which an error is to be lower for a larger law.
SMALLEST_GAIN = 0.01
# Laws of a front whose short-term error is so many times the smallest are not tried.
HOPELESS = 3.0


@dataclass
class Choice:
    """The present selection, updated law by law.

    Attributes:
        laws: by name.
        trims: by name.
    """

    laws: dict[str, Proposal]
    trims: dict[str, float]


def choose(log: FlightLog, populations: Mapping[str, Population], windows: int, mass: float, train: float) -> Choice:
    """Select the laws that best predict flights over seconds; constants and trims are fitted to the log's first part.

    Args:
        log: what was read.
        populations: after evolution.
        windows: how many short windows they evolved in.
        mass: [kg].
        train: share of the rows that may be used.
    """
    choice = Choice({name: each.chosen(windows) for name, each in populations.items()}, {})
    populations = {name: each for name, each in populations.items() if not each.given}
    middle = FIRST_PART * train
    try:
        lengths = [min(length, 0.5 * middle * len(log.time) * log.dt) for length in FIT_S]
        fits = [long_windows(log, 0.0, middle, length) for length in lengths]
        rest_s = (train - middle) * len(log.time) * log.dt
        compare = long_windows(log, middle, train, min(COMPARE_S, 0.5 * rest_s))
        everything = [long_windows(log, 0.0, train, length) for length in lengths]
    except UsageError:
        # Too short for long windows: what evolution says counts.
        return choice
    # At first what the channels move counts, then what the laws leave of them.
    noise = np.std(fits[0].recorded - fits[0].recorded[:, :1], axis=(1, 2)) + 1e-9
    for law in populations:
        choice.laws[law], own = refined(choice, law, choice.laws[law], fits[0], noise, mass)
        choice.trims |= own
    noise = left_by(choice, fits[0], mass)
    independent = rest_s / (compare.commands.shape[1] * log.dt)
    for law, population in populations.items():
        _choose_law(choice, law, population, fits[0], compare, noise, mass, independent)
    for law in populations:
        ways = [(i, trimmed) for i in range(len(fits)) for trimmed in (True, False)]
        tried = [refined(choice, law, choice.laws[law], fits[i], noise, mass, trimmed) for i, trimmed in ways]
        means = [float(_window_errors(choice, law, *each, compare, noise, mass).mean()) for each in tried]
        best = int(np.argmin(means))
        i, trimmed = ways[best]
        choice.laws[law], own = refined(choice, law, tried[best][0], everything[i], noise, mass, trimmed)
        choice.trims |= own
    return choice


def long_windows(log: FlightLog, first: float, last: float, length_s: float) -> Flight:
    """Cut rows ``first`` to ``last`` (fractions) of a log into windows; they overlap if there would be too few."""
    steps = round(length_s / log.dt)
    return windows_of(log, first, last, steps, max(FEWEST_WINDOWS, math.ceil((last - first) * len(log.time) / steps)))


def left_by(choice: Choice, flight: Flight, mass: float) -> Floats:
    """Return each channel's root mean square residual (C,) when the chosen laws are flown, at most its movement."""
    rules = {name: rule_of(each.tree, name) for name, each in choice.laws.items()}
    constants = {name: each.constants[:, None] for name, each in choice.laws.items()}
    found = fly(flight, rules, constants, mass, choice.trims)[:, :, 0]
    left = np.sqrt(np.mean(np.square(found - flight.recorded), axis=(1, 2)))
    moved = np.std(flight.recorded - flight.recorded[:, :1], axis=(1, 2))
    return np.where(np.isfinite(left), np.minimum(left, moved), moved) + 1e-9


def _window_errors(
    choice: Choice, law: str, proposal: Proposal, own: Mapping[str, float], flight: Flight, noise: Floats, mass: float
) -> Floats:
    """Return a law's mean squared error (n,) in each window of a flight, at most FAILED; ``own``: the law's trims."""
    partners = {name: choice.laws[name] for name in partners_of(law, choice.laws)}
    errors = errors_of(law, proposal, partners, flight, noise, mass, {**choice.trims, **own})
    with np.errstate(all="ignore"):
        each = np.square(errors(proposal.constants[:, None], {})[0]).mean(axis=(0, 1))
    return np.where(np.isfinite(each), np.minimum(each, FAILED), FAILED)


def _choose_law(
    choice: Choice,
    law: str,
    population: Population,
    fit: Flight,
    compare: Flight,
    noise: Floats,
    mass: float,
    independent: float,
) -> None:
    """Add to the choice the smallest proposal of a law's Pareto front that is about as good as the best."""
    front = population.pareto()
    likely = [each for each in front if each.error <= HOPELESS * front[-1].error]
    tried = [refined(choice, law, proposal, fit, noise, mass) for proposal in likely]
    errors = [_window_errors(choice, law, *each, compare, noise, mass) for each in tried]
    best = min(errors, key=lambda each: float(each.mean()))
    for (found, own), error in zip(tried, errors, strict=True):
        more = error - best
        clear = max(more.std() / math.sqrt(min(independent, len(more))), SMALLEST_GAIN * best.mean())
        if more.mean() <= clear:
            choice.laws[law] = found
            choice.trims |= own
            return


def refined(
    choice: Choice,
    law: str,
    proposal: Proposal,
    flight: Flight,
    noise: Floats,
    mass: float,
    trimmed: bool = True,
) -> tuple[Proposal, dict[str, float]]:
    """Refit a law's constants and, if ``trimmed``, trims to windows flown with the laws chosen so far; return both."""
    names = TRIMS.get(law, ()) if trimmed else ()
    partners = {name: choice.laws[name] for name in partners_of(law, choice.laws)}
    none = dict.fromkeys(TRIMS.get(law, ()), 0.0)
    errors = errors_of(law, proposal, partners, flight, noise, mass, choice.trims | none)
    count = len(proposal.constants)

    def residual(unknowns: Floats) -> Floats:
        """Return residuals (B, R) for B sets of K unknowns (K, B): errors of flown windows, then trims over TRIM."""
        own = dict(zip(names, unknowns[count:], strict=True))
        flown = errors(unknowns[:count], own).reshape(unknowns.shape[1], -1)
        return np.concatenate([flown, unknowns[count:].T / TRIM], axis=1)

    first = np.concatenate([proposal.constants, [choice.trims.get(name, 0.0) for name in names]])
    found, error = fitted(residual, first, REFINEMENTS)
    if error >= FAILED:
        found = first
    return replace(proposal, constants=found[:count]), none | dict(zip(names, found[count:].tolist(), strict=True))
