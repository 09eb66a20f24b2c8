"""Landmarks and the ranges to them: drawn for a seed, or a user's own, checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from qrsim.errors import UsageError
from qrsim.models.sensors.ranging import noisy_ranges
from qrsim.studies.slam.flight import Floats

# The example of Symington et al., "Simulating Quadrotor UAVs in Outdoor Scenarios", IROS 2014.
LANDMARKS, SIDE, RANGE_LIMIT, RANGE_STD = 10, 40.0, 25.0, 5.0
# Three coordinates need three.
FEWEST_RANGES = 3
# What each random draw of a seed is for: all are independent, and the same whatever else is drawn.
WAYPOINTS, PLACES, GUESSES, NOISE, BETWEEN = range(5)


@dataclass(frozen=True)
class Ranging:
    """Ranges from T + 1 states to L landmarks.

    Attributes:
        ranges: (T + 1, L) [m], NaN where there is none; the mean where one state has several.
        counts: (T + 1, L) how many of them.
        std: of one range [m].
        guess_ned: (L, 3) where the landmarks are looked for first [m].
        true_ned: (L, 3) where they are [m], None where nobody knows.
    """

    ranges: Floats
    counts: Floats
    std: float
    guess_ned: Floats
    true_ned: Floats | None

    @property
    def per_landmark(self) -> npt.NDArray[np.int64]:
        """Number of ranges to each landmark (L,)."""
        return self.counts.sum(axis=0).astype(np.int64)


def generator(seed: int, purpose: int, *numbers: int) -> np.random.Generator:
    """Return a random generator for a seed, a purpose and further numbers, such as a vehicle's."""
    return np.random.default_rng((seed, purpose, *numbers))


def _vehicle_words(vehicle: int) -> tuple[int, ...]:
    """Return the extra seed numbers of a vehicle, which separate its draws; () for vehicle 0."""
    return (vehicle,) if vehicle else ()


def draw_landmarks(seed: int, purpose: int, count: int, centre: Floats, side: float, vehicle: int = 0) -> Floats:
    """Draw ``count`` positions (count, 3) on the ground, uniform in a square of ``side`` [m] about a centre (2,)."""
    horizontal = centre + side * (generator(seed, purpose, *_vehicle_words(vehicle)).random((count, 2)) - 0.5)
    return np.concatenate([horizontal, np.zeros((count, 1))], axis=1)


def landmarks_of(seed: int, centre: Floats) -> Floats:
    """Draw the true positions (L, 3) of a seed's landmarks about a centre (2,)."""
    return draw_landmarks(seed, PLACES, LANDMARKS, centre, SIDE)


def guesses_of(seed: int, centre: Floats, count: int = LANDMARKS) -> Floats:
    """Draw the initial guesses (L, 3) of a seed's landmarks about a centre (2,)."""
    return draw_landmarks(seed, GUESSES, count, centre, SIDE)


def landmarks_given(
    north_east: Floats, true_ned: object, guess_ned: object, ranged: bool, seed: int
) -> tuple[Floats | None, Floats]:
    """Return landmarks' true positions (L, 3) or None, and first guesses; ``ranged``: a user gives the ranges.

    Args:
        north_east: (T, 2) where was flown.
        true_ned, guess_ned: (L, 3) as given, or None.
        ranged: whether there are ranges of a user's own, so that no landmarks are drawn.
        seed: of what is drawn, about the middle of the flight.

    Raises:
        UsageError: places that are none, or guesses of more or fewer landmarks than there are.
    """
    centre = 0.5 * (north_east.min(axis=0) + north_east.max(axis=0))
    known = None if true_ned is None else _checked_positions("landmarks_ned", true_ned)
    guess = None if guess_ned is None else _checked_positions("landmarks_guess_ned", guess_ned)
    if not ranged and known is None:
        known = landmarks_of(seed, centre)
    given = known if known is not None else guess
    if given is None:
        raise UsageError("ranges: give the number of landmarks by landmarks_ned or landmarks_guess_ned, (L, 3)")
    count = len(given)
    if guess is None:
        guess = guesses_of(seed, centre, count)
    if known is not None and len(guess) != count:
        raise UsageError(f"landmarks_guess_ned: {len(guess)} places for {count} landmarks")
    return known, guess


def _checked_positions(name: str, values: object) -> Floats:
    """Convert values to positions (L, 3) [m]; raises UsageError, which names them, unless they are finite."""
    array = np.asarray(values, np.float64)
    if array.ndim != 2 or array.shape[1:] != (3,) or not len(array) or not np.isfinite(array).all():
        raise UsageError(f"{name}: expected finite places (L, 3) [m], found shape {array.shape}")
    return array


def measure_ranges(
    position_ned: Floats,
    landmarks_ned: Floats,
    guess_ned: Floats,
    seed: int,
    std: float,
    limit: float,
    vehicle: int = 0,
    alone: bool = True,
) -> Ranging:
    """Simulate ranges (T + 1, L) to landmarks within ``limit`` [m], with white noise; ``alone``: raise if none is.

    The noise is of the seed and of the vehicle's number.

    Raises:
        UsageError: no landmark is ever within the limit, of a vehicle that flies ``alone``.
    """
    distance = np.linalg.norm(position_ned[:, None] - landmarks_ned[None], axis=-1)
    if alone and not (distance <= limit).any():
        raise UsageError(f"no landmark comes within {limit:g} m of the flight; the nearest {distance.min():.1f} m")
    noise = std * generator(seed, NOISE, *_vehicle_words(vehicle)).standard_normal(distance.shape)
    ranges = noisy_ranges(distance, noise, distance <= limit)
    return Ranging(ranges, np.isfinite(ranges).astype(np.float64), std, guess_ned, landmarks_ned)


def given_ranges(
    rows: npt.ArrayLike, time: Floats, count: int, std: float, guess_ned: Floats, true_ned: Floats | None
) -> Ranging:
    """Check a user's ranges: rows (R, 3) of time [s], landmark index from 0, range [m]; return them by state.

    Raises:
        UsageError: a row that is not finite, a range that is negative, a landmark that is not there, or a time without
            a state (the row is named); or no row at all.
    """
    table = np.asarray(rows, np.float64)
    if table.ndim != 2 or table.shape[1] != 3 or not len(table):
        raise UsageError(f"ranges: expected rows (R, 3) of time, landmark and range, found shape {table.shape}")
    for i in np.flatnonzero(~np.isfinite(table).all(axis=1))[:1]:
        raise UsageError(f"ranges: row {i} is {table[i].tolist()}: leave out missing measurements")
    for i in np.flatnonzero(table[:, 2] < 0.0)[:1]:
        raise UsageError(f"ranges: row {i}: a range of {table[i, 2]:g} m is negative")
    number = np.round(table[:, 1]).astype(np.int64)
    for i in np.flatnonzero((number != table[:, 1]) | (number < 0) | (number >= count))[:1]:
        raise UsageError(f"ranges: row {i}: landmark {table[i, 1]:g}; expected a number from 0 to {count - 1}")
    state = np.round((table[:, 0] - time[0]) / (time[1] - time[0])).astype(np.int64)
    inside = (state >= 0) & (state < len(time))
    on_state = inside & (np.abs(time[np.where(inside, state, 0)] - table[:, 0]) < 1e-6)
    for i in np.flatnonzero(~on_state)[:1]:
        raise UsageError(
            f"ranges: row {i}: no state at {table[i, 0]:g} s; states are every {time[1] - time[0]:g} s from "
            f"{time[0]:g} to {time[-1]:g} s (see state_period)"
        )
    total, counts = np.zeros((len(time), count)), np.zeros((len(time), count))
    np.add.at(total, (state, number), table[:, 2])
    np.add.at(counts, (state, number), 1.0)
    ranges = np.where(counts > 0, total / np.maximum(counts, 1.0), np.nan)
    return Ranging(ranges, counts, std, guess_ned, true_ned)
