"""Cooperative range-only SLAM on a recorded run with several vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from qrsim.errors import UsageError, warn_user
from qrsim.runs import Run, open_run
from qrsim.studies.slam.between import Between, measure_between, no_ranges
from qrsim.studies.slam.cooperative import CooperativeSlam, estimate_together
from qrsim.studies.slam.estimate import MOST_ITERATIONS, check_numbers
from qrsim.studies.slam.flight import Flight, first_states
from qrsim.studies.slam.ranging import RANGE_LIMIT, RANGE_STD, Ranging, given_ranges, landmarks_given, measure_ranges
from qrsim.studies.slam.recorded import between_of_run, flight_of_run


def cooperative_from_run(
    run: Run | Path | str,
    *,
    vehicles: Sequence[str] | None = None,
    between: Literal["measured", "simulated", "none"] = "measured",
    between_std: float | None = None,
    states: Literal["full", "poses"] = "full",
    prior: Literal["start", "estimate"] = "estimate",
    landmarks_ned: npt.ArrayLike | None = None,
    landmarks_guess_ned: npt.ArrayLike | None = None,
    ranges: Sequence[npt.ArrayLike] | None = None,
    range_std: float = RANGE_STD,
    range_limit: float = RANGE_LIMIT,
    seed: int | None = None,
    state_period: float = 0.1,
    fix_std: float | None = None,
    bias_time_constant: float | None = None,
    common_share: float = 0.0,
    own_time_constant: float | None = None,
    process_noise: float | None = None,
    iterations: int = MOST_ITERATIONS,
    damping: Literal["metres", "diagonal"] = "metres",
) -> CooperativeSlam:
    """Estimate the trajectories of several vehicles of a run together, and landmarks that they share.

    The vehicles are coupled by the landmarks and by ranges to each other; see docs/explanation/slam_together.md.

    Args:
        run: a run folder, or what ``qrsim.open_run`` returned.
        vehicles: names of N vehicles; None: all.
        between: ranges between vehicles as the sensors ``ranging`` of the run "measured" them, "simulated" with the
            noise and losses of that sensor, or "none".
        between_std: white noise of a range between vehicles [m]; None: that of the sensor.
        states: "full" are the 13 of the vehicle's model, "poses" are position and heading only.
        prior: as in ``qrsim.slam.from_run``; the graph is "gnss".
        landmarks_ned: (L, 3) true places [m]; None: drawn at random on the ground around all flights.
        landmarks_guess_ned: (L, 3) where to begin [m]; None: drawn at random in the same place.
        ranges: your own, of each vehicle rows (R, 3) as in ``qrsim.slam.from_run``; None: simulated.
        range_std: white noise of a range to a landmark [m].
        range_limit: greatest simulated range to a landmark [m].
        seed: of simulated landmarks, guesses and ranges; None: the run's.
        state_period: time between two states, a multiple of the simulator's step [s].
        fix_std: standard deviation of a fix per axis [m]; None: measured against the truth of the run.
        bias_time_constant: model the fixes' errors as Ornstein-Uhlenbeck states of this time constant [s].
        common_share: part of their variance, 0 to 1, that is one state for all vehicles; the rest are states of each.
        own_time_constant: of these rests [s]; None: ``bias_time_constant``.
        process_noise: replaces the vehicle's own process noise, as in ``qrsim.slam.from_run``.
        iterations: greatest number of linear solutions.
        damping: as in ``qrsim.slam.from_run``.

    Raises:
        UsageError: an unknown option or vehicle, measurements that come between states, or no landmark in range.
        RunError: the run lacks something that is needed, or the problem does not fit into memory.
    """
    check_numbers(
        range_std=range_std,
        range_limit=range_limit,
        fix_std=fix_std,
        bias_time_constant=bias_time_constant,
        process_noise=process_noise,
        state_period=state_period,
        between_std=between_std,
        own_time_constant=own_time_constant,
    )
    if between not in ("measured", "simulated", "none"):
        raise UsageError(f"between: '{between}' is not known; choose from measured, simulated, none")
    opened = run if isinstance(run, Run) else open_run(run)
    names = list(opened.vehicles if vehicles is None else vehicles)
    _check_names(names)
    number = opened.info.seed if seed is None else seed
    if number < 0:
        raise UsageError(f"seed: {number} is negative")
    flights = [flight_of_run(opened, name, state_period, process_noise) for name in names]
    shortest = min(len(flight.truth) for flight in flights)
    flights = [first_states(flight, shortest) for flight in flights]
    rangings = _rangings(flights, landmarks_ned, landmarks_guess_ned, ranges, range_std, range_limit, number)
    found = estimate_together(
        flights,
        rangings,
        _vehicle_ranges(opened, names, flights, between, between_std, state_period, number),
        states=states,
        prior=prior,
        fix_std=fix_std,
        bias_time_constant=bias_time_constant,
        common_share=common_share,
        own_time_constant=own_time_constant,
        iterations=iterations,
        damping=damping,
    )
    for problem in found.problems:
        warn_user(problem)
    return found


def _check_names(names: Sequence[str]) -> None:
    """Raise UsageError if no vehicle is named, or one is named twice."""
    if not names:
        raise UsageError("vehicles: none; cooperative SLAM is of at least one")
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"vehicles: '{name}' is there twice")


def _rangings(
    flights: Sequence[Flight],
    landmarks_ned: npt.ArrayLike | None,
    guess_ned: npt.ArrayLike | None,
    ranges: Sequence[npt.ArrayLike] | None,
    std: float,
    limit: float,
    seed: int,
) -> list[Ranging]:
    """Return each vehicle's ranges to the landmarks: a user's, or simulated to given or drawn landmarks."""
    north_east = np.concatenate([flight.truth[:, :2] for flight in flights])
    known, guess = landmarks_given(north_east, landmarks_ned, guess_ned, ranges is not None, seed)
    if ranges is not None:
        if len(ranges) != len(flights):
            raise UsageError(f"ranges: tables of {len(ranges)} vehicles for {len(flights)}")
        pairs = zip(ranges, flights, strict=True)
        return [given_ranges(rows, flight.time, len(guess), std, guess, known) for rows, flight in pairs]
    assert known is not None
    return [
        measure_ranges(flight.truth[:, :3], known, guess, seed, std, limit, vehicle=i, alone=False)
        for i, flight in enumerate(flights)
    ]


def _vehicle_ranges(
    run: Run,
    names: Sequence[str],
    flights: Sequence[Flight],
    kind: str,
    std: float | None,
    state_period: float,
    seed: int,
) -> Between:
    """Return the ranges between vehicles by ``kind``: "none", "simulated" with deviation ``std``, or "measured"."""
    count = len(flights[0].truth)
    if kind == "none" or len(names) == 1:
        return no_ranges(len(names), count)
    if kind == "simulated":
        positions = np.stack([flight.truth[:, :3] for flight in flights])
        return measure_between(positions, seed) if std is None else measure_between(positions, seed, std)
    return between_of_run(run, names, state_period, count, std)
