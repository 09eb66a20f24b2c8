"""What cooperation does to range-only SLAM, by what the vehicles' GNSS errors have in common (``make evidence``).

Pelicans over the same landmarks range to each other and are solved together, 1, 2 and 5 of the same flights. NEES, its
band and coverage are those of ``slam_consistency``, of the first vehicle in the middle of the flight, so that the seeds
are independent; errors of more vehicles are compared with those of the first one alone, seed by seed. On a busy machine
one thread of BLAS (OPENBLAS_NUM_THREADS=1) is several times as fast as two, because the matrices are small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from evidence.slam_consistency import band, judged, nees
from qrsim.studies.slam import team
from qrsim.studies.slam.between import BETWEEN_STD, Between
from qrsim.studies.slam.cooperative import CooperativeSlam, estimate_together
from qrsim.studies.slam.estimate import BIAS_TIME_CONSTANT
from qrsim.studies.slam.example import MEMORY
from qrsim.studies.slam.flight import Flight
from qrsim.studies.slam.study import interval, paired

DOC = "errors and NEES of 1, 2 and 5 vehicles that range to each other, by what their GNSS errors have in common"
SEED = 20140918
STATE_PERIOD, RECEIVER = 0.2, "m8n"


@dataclass(frozen=True)
class Size:
    """Seeds, seconds of each flight, what the unknowns are, and numbers of vehicles that are solved together."""

    seeds: int
    seconds: float
    states: str
    vehicles: tuple[int, ...]


FULL, SMALL = Size(50, 60.0, "full", (1, 2, 5)), Size(6, 30.0, "poses", (1, 3))


@dataclass(frozen=True)
class Case:
    """Whose errors, and how they are modelled.

    Attributes:
        flights: kind of the flights.
        time_constant: of the error as a state [s]; None: taken for white.
        common: part of its variance that is one state for all vehicles; "measured": as of the flights' own fixes.
        own: whether the rest has a time constant of its own, as of the flights' own fixes.
    """

    flights: str
    time_constant: float | None = None
    common: float | str = 0.0
    own: bool = False


CASES = {
    "white": Case("white"),
    "own_as_white": Case("own"),
    "own_as_own_states": Case("own", BIAS_TIME_CONSTANT),
    "shared_as_white": Case("shared"),
    "shared_as_own_states": Case("shared", BIAS_TIME_CONSTANT),
    "shared_as_one_state": Case("shared", BIAS_TIME_CONSTANT, 1.0),
    "receiver_as_own_states": Case("receiver", MEMORY[RECEIVER]),
    "receiver_as_common_and_own_states": Case("receiver", MEMORY[RECEIVER], "measured"),
    "receiver_as_common_and_own_memory": Case("receiver", MEMORY[RECEIVER], "measured", own=True),
}
IN_SMALL = ("white", "own_as_own_states", "shared_as_own_states", "shared_as_one_state")


def common_share(flown: list[list[Flight]]) -> float:
    """Return the part of the variance of the fixes' errors that is common to the vehicles of a seed: from -1 to 1."""
    errors = np.array([[flight.fix_error for flight in flights] for flights in flown])
    vehicles = errors.shape[1]
    of_sum = np.mean(np.square(errors.sum(axis=1)))
    own = vehicles * np.mean(np.square(errors))
    return float((of_sum - own) / (own * (vehicles - 1)))


def own_time_constant(flown: list[list[Flight]]) -> float:
    """Return when the correlation of what is not the vehicles' mean falls to 1/e [s]; the last lag if it does not."""
    errors = np.array([[flight.fix_error for flight in flights] for flights in flown])
    own = errors - errors.mean(axis=1, keepdims=True)
    lags = range(1, own.shape[2] - 1)
    correlation = np.array([np.mean(own[:, :, lag:] * own[:, :, :-lag]) for lag in lags]) / np.mean(np.square(own))
    below = np.flatnonzero(correlation < np.exp(-1.0))
    return STATE_PERIOD * (lags[below[0]] if below.size else lags[-1])


def fly(kinds: set[str], seeds: range, size: Size) -> dict[str, list[list[Flight]]]:
    """Fly each kind: (S)(N) flights."""
    count, how = max(size.vehicles), (size.seconds, STATE_PERIOD)
    own = team.own_flights(seeds, count, *how)
    made = {
        "own": lambda: own,
        "white": lambda: team.white_flights(seeds, own, *how),
        "shared": lambda: team.shared_flights(seeds, count, *how),
        "receiver": lambda: team.shared_flights(seeds, count, *how, gnss=RECEIVER),
    }
    return {kind: make() for kind, make in made.items() if kind in kinds}


def part_of(between: Between, vehicles: int) -> Between:
    """Return the ranges among the first of the vehicles only."""
    kept = np.all(between.pairs < vehicles, axis=1)
    return Between(between.pairs[kept], between.ranges[:, kept], between.counts[:, kept], between.std)


def solve(
    flights: list[Flight], seed: int, vehicles: int, states: str, case: Case, share: float, own: float | None = None
) -> CooperativeSlam:
    """Solve the first of the vehicles of a seed together."""
    rangings, between = team.rangings_of(flights, seed), team.between_of(flights, seed)
    return estimate_together(
        flights[:vehicles],
        rangings[:vehicles],
        part_of(between, vehicles),
        states=states,
        bias_time_constant=case.time_constant,
        common_share=share,
        own_time_constant=own,
    )


def of_case(flown: list[list[Flight]], seeds: range, size: Size, case: Case) -> dict[str, Any]:
    """Return errors, NEES and coverage by number of vehicles."""
    share = float(np.clip(common_share(flown), 0.0, 1.0)) if case.common == "measured" else float(case.common)
    own = own_time_constant(flown) if case.own else None
    found: dict[str, Any] = {}
    alone = None
    for vehicles in size.vehicles:
        pairs = zip(flown, seeds, strict=True)
        solved = [solve(flights, seed, vehicles, size.states, case, share, own) for flights, seed in pairs]
        errors = np.array([each.trajectory_rmse_m[0] for each in solved])
        alone = errors if alone is None else alone
        over_time = np.mean([of_first(each) for each in solved], axis=0)
        low, high = band(len(seeds), 2)
        part = {
            "trajectory_m": interval(errors),
            "landmarks_m": interval(np.array([each.landmark_rmse_m for each in solved])),
            "position": judged(np.array([of_first(each)[len(each.time) // 2] for each in solved]), 2),
            "times_inside_percent": 100.0 * float(np.mean((over_time >= low) & (over_time <= high))),
            "not_converged": sum(not each.converged for each in solved),
        }
        if vehicles > 1:
            part["gain_m"] = paired(errors, alone)
            part["relative_m"] = interval(np.array([each.relative_rmse_m for each in solved]))
            part["relative_position"] = judged(np.array([of_pair(each) for each in solved]), 2)
        found[f"vehicles_{vehicles}"] = part
    return {"common_share_assumed": share, **found}


def of_first(found: CooperativeSlam) -> Any:
    """Return the NEES of the horizontal positions (T + 1,) of the first vehicle."""
    error = (found.position_ned - found.truth_ned)[0, :, :2]
    return nees(error, found.covariance_of(0)[:, :2, :2])


def of_pair(found: CooperativeSlam) -> float:
    """Return the NEES of the first vehicle's horizontal position from the second one, in the middle of the flight."""
    error, middle = found.position_ned - found.truth_ned, len(found.time) // 2
    covariance = found.relative_covariance(0, 1)[middle, :2, :2]
    return float(nees((error[0] - error[1])[middle, :2], covariance))


def run(full: bool) -> dict[str, Any]:
    """Return what each case says of its errors and of itself, by number of vehicles."""
    size = FULL if full else SMALL
    seeds = range(SEED, SEED + size.seeds)
    cases = {name: case for name, case in CASES.items() if full or name in IN_SMALL}
    flown = fly({case.flights for case in cases.values()}, seeds, size)
    fixes = {
        kind: {
            "rms_m": float(np.sqrt(np.mean([np.square(flight.fix_error) for each in flights for flight in each]))),
            "common_share": common_share(flights),
            "own_time_constant_s": own_time_constant(flights),
        }
        for kind, flights in flown.items()
    }
    found = {name: of_case(flown[case.flights], seeds, size, case) for name, case in cases.items()}
    about = {"seeds": size.seeds, "flight_s": size.seconds, "between_std_m": BETWEEN_STD}
    return {**about, "fixes": fixes, **found}
