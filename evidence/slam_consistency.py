"""Whether range-only SLAM is as sure of itself as it may be: NEES and coverage over seeds (``make evidence``).

At each time the normalised squared error (NEES) of the horizontal position, averaged over S independent seeds, is
chi-square of 2 S degrees of freedom over S where the estimate is right about itself (Bar-Shalom et al., 2001, 5.4.2).
The landmarks of a flight share its errors, so each seed gives one: the determined one with the lowest number.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from evidence._intervals import share
from qrsim.studies.slam import example
from qrsim.studies.slam import study as studies
from qrsim.studies.slam.estimate import BIAS_TIME_CONSTANT, Slam, estimate

DOC = "NEES and coverage of range-only SLAM under white noise, and coloured noise taken for white or as a state"
SEED = 20140918
CONFIDENCE = 0.95
# Seeds, seconds of each flight, what the unknowns are; five states per second.
FULL, SMALL = (50, 60.0, "full"), (8, 30.0, "poses")
STATE_PERIOD = 0.2
# Noise of the fixes, and the time constant of their error as a state.
CASES: dict[str, tuple[str, float | None]] = {
    "white": ("white", None),
    "coloured": ("coloured", None),
    "coloured_as_state": ("coloured", BIAS_TIME_CONSTANT),
}


def nees(errors: Any, covariances: Any) -> Any:
    """Return the normalised squared errors (...,) of errors (..., N) with covariances (..., N, N)."""
    return np.sum(errors * np.linalg.solve(covariances, errors[..., None])[..., 0], axis=-1)


def band(seeds: int, size: int) -> tuple[float, float]:
    """Return where the mean over seeds of a consistent NEES of ``size`` numbers is with CONFIDENCE."""
    low, high = scipy.stats.chi2.ppf([0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE], size * seeds) / seeds
    return float(low), float(high)


def judged(values: Any, size: int) -> dict[str, Any]:
    """Return mean NEES with its band and coverage of the stated 95 % regions, of one value (S,) a seed."""
    low, high = band(len(values), size)
    mean = float(values.mean())
    inside = share(values <= scipy.stats.chi2.ppf(CONFIDENCE, size))
    return {
        "seeds": len(values),
        "nees": mean,
        "median": float(np.median(values)),
        "band_low": low,
        "band_high": high,
        "inside": float(low <= mean <= high),
        "coverage": inside,
    }


def of_solution(found: Slam) -> tuple[Any, float | None]:
    """Return the NEES of the horizontal positions (T + 1,), and that of the first determined landmark."""
    error = (found.position_ned - found.flight.truth[:, :3])[:, :2]
    places = nees(error, found.position_covariance[:, :2, :2])
    known = np.flatnonzero(found.determined)
    if not len(known) or found.ranging.true_ned is None:
        return places, None
    first = known[0]
    away = found.landmarks_ned[first] - found.ranging.true_ned[first]
    return places, float(nees(away, found.landmarks_covariance[first]))


def of_case(flights: list[Any], seeds: range, states: str, bias: float | None) -> dict[str, Any]:
    """Return NEES and coverage over the seeds of one kind of noise and treatment."""
    positions, landmarks, failed = [], [], 0
    for flight, seed in zip(flights, seeds, strict=True):
        ranging = example.ranging_of(flight, seed)
        found = estimate(flight, ranging, graph="gnss", states=states, bias_time_constant=bias)
        failed += not found.converged
        places, landmark = of_solution(found)
        positions.append(places)
        landmarks.append(landmark)
    over_time = np.mean(positions, axis=0)
    low, high = band(len(seeds), 2)
    middle = np.array(positions)[:, len(over_time) // 2]
    return {
        "not_converged": failed,
        "position": judged(middle, 2),
        "position_over_time": {
            "nees": float(over_time.mean()),
            "times_inside_percent": 100.0 * float(np.mean((over_time >= low) & (over_time <= high))),
            "each_second": {f"s_{i}": float(value) for i, value in enumerate(over_time[:: round(1.0 / STATE_PERIOD)])},
        },
        "landmark": judged(np.array([value for value in landmarks if value is not None]), 3),
    }


def run(full: bool) -> dict[str, Any]:
    """Return what each case says of itself against its errors; positions in the middle of the flight."""
    count, seconds, states = FULL if full else SMALL
    seeds = range(SEED, SEED + count)
    flights = studies.fly(seeds, duration=seconds, state_period=STATE_PERIOD)
    found = {name: of_case(flights[noise], seeds, states, bias) for name, (noise, bias) in CASES.items()}
    return {"seeds": count, "flight_s": seconds, **found}
