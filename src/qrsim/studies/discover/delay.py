"""Delay of commands in a log: first from polynomials, before any law is known, then with the laws."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping

import numpy as np
import scipy

from qrsim.errors import UsageError
from qrsim.studies.discover.choosing import FIT_S, Choice, left_by, long_windows, refined
from qrsim.studies.discover.evolution import REFINEMENTS, Proposal, errors_of, fitted, slopes
from qrsim.studies.discover.flight import Flight, Floats, windows_of
from qrsim.studies.discover.proposals import polynomial_tree
from qrsim.studies.flight_logs import FlightLog

LONGEST_S = 0.7
# Windows whose slopes are looked at, and their length in steps.
WINDOWS, STEPS = 400, 15
# How far from the first estimate flights may move it, and how exactly, in steps of the log.
REACH, TOLERANCE = 3.0, 0.05


def rough_delay(log: FlightLog, train: float, given: Collection[str] = ()) -> float:
    """Estimate the command delay [s], in whole steps of the log, that best explains changes of rates and thrust.

    No law need be known: what counts is what polynomials of second degree in the inputs of each law leave, of the
    slopes of the rates, and of thrust in flight, because its limited slope would look like delay.

    Args:
        log: what was read.
        train: share of the rows that may be used.
        given: laws that the log does not show.
    """
    delays = log.dt * np.arange(round(LONGEST_S / log.dt) + 1)
    unexplained = [_unexplained(log.delayed(float(delay)), train, given) for delay in delays]
    return float(delays[int(np.argmin(unexplained))])


def _unexplained(log: FlightLog, train: float, given: Collection[str]) -> float:
    """Return the misfit of polynomials in each law's inputs: sum of log(residual variance / variance) over rows.

    Drag has no part in it. Thrust is fitted in flight, because its rate of change is limited and would look like delay.
    Without enough rows the misfit is infinite.
    """
    try:
        flight = windows_of(log, 0.0, train, STEPS, WINDOWS)
    except UsageError:
        return math.inf
    total = 0.0
    for law in (name for name in flight.laws if name not in given):
        if law == "thrust":
            total += flight.recorded[0].size * math.log(_thrust_misfit(flight))
        elif law != "drag":
            leaves, slope = slopes(flight, law)
            features = _features(leaves)
            left = slope - features @ np.linalg.lstsq(features, slope, rcond=None)[0]
            total += len(slope) * math.log(float(np.mean(left**2) / np.var(slope)) + 1e-12)
    return total


def _thrust_misfit(flight: Flight) -> float:
    """Fit thrust as a quadratic of the command so that simulated flights match; return the mean square error left."""
    tree = polynomial_tree([(0,), (1,), (2,)], "thrust")
    scale = np.std(flight.recorded, axis=(1, 2)) + 1e-9
    (throttle,), thrust = slopes(flight, "thrust")
    start = np.asarray(np.polynomial.polynomial.polyfit(throttle, thrust, 2), np.float64)
    errors = errors_of("thrust", Proposal(tree, start), {}, flight, scale, 1.0, {})
    return fitted(lambda tried: errors(tried, {}).reshape(tried.shape[1], -1), start, REFINEMENTS)[1]


def _features(leaves: list[Floats]) -> Floats:
    """Return columns (N, F) of 1, the standardised inputs (N,), their squares and their products."""
    one = [np.ones_like(leaves[0]), *((leaf - leaf.mean()) / (leaf.std() + 1e-12) for leaf in leaves)]
    return np.stack([a * b for a, b in itertools.combinations_with_replacement(one, 2)], axis=1)


def refined_delay(
    log: FlightLog,
    laws: Mapping[str, Proposal],
    mass: float,
    train: float,
    first: float,
    given: Collection[str] = (),
) -> float:
    """Estimate the command delay [s] with which refitted laws best fly windows of some seconds.

    Args:
        log: what was read.
        laws: by name.
        mass: [kg].
        train: share of the rows that may be used.
        first: [s], where it is looked for.
        given: laws that stay as they are.
    """
    length = min(FIT_S[0], 0.5 * train * len(log.time) * log.dt)
    try:
        flight = long_windows(log.delayed(first), 0.0, train, length)
    except UsageError:
        return first
    noise = left_by(Choice(dict(laws), {}), flight, mass)

    def misfit(delay: float) -> float:
        """Return the mean square error of refitted laws at a delay [s], in units of the noise."""
        late, choice = long_windows(log.delayed(delay), 0.0, train, length), Choice(dict(laws), {})
        for law in (name for name in laws if name not in given):
            choice.laws[law], own = refined(choice, law, choice.laws[law], late, noise, mass)
            choice.trims |= own
        return float(np.mean(np.square(left_by(choice, late, mass) / noise)))

    bounds = max(0.0, first - REACH * log.dt), first + REACH * log.dt
    found = scipy.optimize.minimize_scalar(
        misfit, bounds=bounds, method="bounded", options={"xatol": TOLERANCE * log.dt}
    )
    # A bounded search never ends at a bound itself, and no delay is the likeliest of all.
    at_bound = misfit(bounds[0])
    return float(bounds[0] if at_bound <= found.fun else found.x)
