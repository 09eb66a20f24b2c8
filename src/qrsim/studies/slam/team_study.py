"""What a vehicle gains by others, by what their GNSS errors have in common: ``qrsim slam --vehicles``.

All vehicles of a seed fly over its landmarks; the first one is solved alone and together with the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.files import Content
from qrsim.studies.slam import team
from qrsim.studies.slam.cooperative import CooperativeSlam, estimate_together
from qrsim.studies.slam.estimate import BIAS_TIME_CONSTANT
from qrsim.studies.slam.example import MEMORY, STATE_PERIOD, base_world
from qrsim.studies.slam.flight import Flight, ticks_between
from qrsim.studies.slam.intervals import interval, paired
from qrsim.studies.slam.memory import available_bytes, check_memory, state_size
from qrsim.studies.slam.ranging import LANDMARKS
from qrsim.studies.slam.study import BYTES_PER_TICK

# Whose errors, whether they are modelled as states, and which part of these is common to all vehicles.
CASES: dict[str, tuple[str, bool, float]] = {
    "white": ("white", False, 0.0),
    "own_as_white": ("own", False, 0.0),
    "own_as_own_states": ("own", True, 0.0),
    "shared_as_white": ("shared", False, 0.0),
    "shared_as_own_states": ("shared", True, 0.0),
    "shared_as_one_state": ("shared", True, 1.0),
}


@dataclass(frozen=True)
class TeamStudy:
    """Solutions of S seeds, by case: of the first vehicle alone, and of all N."""

    vehicles: int
    seeds: tuple[int, ...]
    alone: dict[str, list[CooperativeSlam]]
    together: dict[str, list[CooperativeSlam]]

    def numbers(self) -> Content:
        """Return errors [m] of the first vehicle and between vehicles, with tests over seeds, as a dict for JSON."""
        found: Content = {"vehicles": self.vehicles, "seeds": len(self.seeds), "cases": {}}
        for case in self.alone:
            one, all_of_them = (_first_errors(part[case]) for part in (self.alone, self.together))
            found["cases"][case] = {
                "alone_m": interval(one),
                "together_m": interval(all_of_them),
                "gain_m": paired(all_of_them, one) if len(one) > 1 else {},
                "relative_m": interval(np.array([each.relative_rmse_m for each in self.together[case]])),
                "not_converged": sum(not each.converged for each in (*self.alone[case], *self.together[case])),
            }
        return found


def _first_errors(solved: list[CooperativeSlam]) -> NumpyArray:
    """Return the root mean square trajectory error (S,) [m] of the first vehicle in each of S solutions."""
    return np.array([each.trajectory_rmse_m[0] for each in solved])


def compare(
    seeds: Sequence[int],
    vehicles: int,
    duration: float,
    *,
    states: str = "full",
    gnss: str | None = None,
    state_period: float = STATE_PERIOD,
    progress: Callable[[], None] = lambda: None,
) -> TeamStudy:
    """Fly and solve N vehicles of each seed alone and together, in all CASES of GNSS noise.

    Args:
        seeds: of the flights.
        vehicles: N.
        duration: of each flight [s].
        states: as in ``qrsim.slam.from_run``.
        gnss: preset of a receiver of type gnss for the coloured flights; None: the published receiver.
        state_period: between two states [s].
        progress: called after each seed of each case.

    Raises:
        UsageError: too many vehicles, or none, or a duration that is no whole number of ticks.
        RunError: it does not fit into memory.
    """
    team.check_vehicles(vehicles)
    ticks = ticks_between(duration, base_world().time_step, "duration")
    smaller = "take a shorter --duration, --states poses, fewer --vehicles or fewer --seeds"
    size = vehicles * state_size(states, bias=True)
    flown = 3 * BYTES_PER_TICK * ticks * len(seeds) * vehicles
    check_memory(round(duration / state_period) + 1, size, LANDMARKS, available_bytes(), flown, smaller)
    how = (duration, state_period)
    own = team.own_flights(seeds, vehicles, *how, gnss=gnss)
    flights = {
        "own": own,
        "shared": team.shared_flights(seeds, vehicles, *how, gnss=gnss),
        "white": team.white_flights(seeds, own, *how),
    }
    memory = BIAS_TIME_CONSTANT if gnss is None else MEMORY[gnss]
    found = TeamStudy(vehicles, tuple(seeds), {}, {})
    for name, (kind, modelled, share) in CASES.items():
        options: dict[str, object] = {"states": states, "common_share": share}
        options["bias_time_constant"] = memory if modelled else None
        for seed, flown_of in zip(seeds, flights[kind], strict=True):
            for count, solved in ((1, found.alone), (vehicles, found.together)):
                solved.setdefault(name, []).append(_solve_team(flown_of[:count], seed, options))
            progress()
    return found


def _solve_team(flights: Sequence[Flight], seed: int, options: dict[str, Any]) -> CooperativeSlam:
    """Estimate the flights of one seed together, with simulated ranges of that seed."""
    rangings, between = team.rangings_of(flights, seed), team.between_of(flights, seed)
    return estimate_together(flights, rangings, between, **options)
