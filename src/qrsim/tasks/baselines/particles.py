"""Fit of plumes in a wind to the task's locations and to measurements: particles with random moves.

Each particle is a bearing of the wind and some sources. Locations asked for lie uniformly where the concentration is
above a threshold, in tubes that begin at the sources. Particles are as likely as their tubes are small and hold all
locations, and as they explain the measurements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.models.scene.plume import INNER
from qrsim.tasks.baselines.tubes import WindPlume

# Particles while locations are searched for tubes, after that, and where nobody tells locations.
SEARCHERS, PARTICLES, UNTOLD = 192, 80, 500
# Softness of a tube's edge in the logarithm of the concentration, made harder and harder, and sweeps at each.
SOFTNESS, SWEEPS = (3.0, 1.5, 0.8, 0.4, 0.2, 0.1), 10
# Moves of every particle when something new was measured.
SWEEPS_LATER = 2
# The part of the locations that may be anywhere in the box after all.
OUTLIERS = 0.01
# What a source more costs in log-likelihood: about what four numbers cost that some dozens of points tell.
PER_SOURCE = 8.0
# Measurements in cells of this size [m] are taken together, and so many cells with most to say are looked at.
CELL, MOST_CELLS = 3.0, 100
# Errors of places and of the mean make errors of this part of a concentration, and Student's t has heavy tails.
RELATIVE, FREEDOM = 0.25, 4.0
# Steps of a source along the wind, across it and in height [m] and in the logarithm of its rate, and of the bearing.
STEP, TURN = (5.0, 1.0, 1.0, 0.3), 0.04
# How far [m] upwind of a location a new source is looked for, in the mean, and how far beside it; or anywhere.
UPWIND, BESIDE, ANYWHERE = 40.0, 3.0, 0.1
# Something was smelt where the mean is so many standard deviations above zero.
SMELT = 4.0


@dataclass
class Guess:
    """N particles of S sources at most.

    Attributes:
        place: (N, S, 3) sources, NED [m].
        rate: (N, S) logarithm of the rate.
        there: (N, S) whether the particle has that source.
        bearing: (N,) where the wind blows to [rad].
        volume: (N, S) of the source's tube [m^3].
        at_locations, at_measured: (N, S, P) concentration that the source makes, if its rate were 1.
    """

    place: NumpyArray
    rate: NumpyArray
    there: NumpyArray
    bearing: NumpyArray
    volume: NumpyArray
    at_locations: NumpyArray
    at_measured: NumpyArray

    @property
    def rates(self) -> NumpyArray:
        """Release rates (N, S) of the particles' sources, 0 for missing sources."""
        return np.where(self.there, np.exp(self.rate), np.zeros_like(self.rate))

    @property
    def bearings(self) -> NumpyArray:
        """Wind bearings (N, S) [rad], the same for all sources of a particle."""
        return np.broadcast_to(self.bearing[:, None], self.rate.shape)

    def picked(self, rows: NumpyArray) -> Guess:
        """Return the particles with these indices."""
        return Guess(**{name: value[rows] for name, value in vars(self).items()})

    def copy(self) -> Guess:
        """Return a copy of all particles that can be changed."""
        return Guess(**{name: value.copy() for name, value in vars(self).items()})

    def where(self, taken: NumpyArray, other: Guess) -> Guess:
        """Return these particles, those selected by the mask ``taken`` (N,) replaced with another guess's."""

        def either(own: NumpyArray, others: NumpyArray) -> NumpyArray:
            """Return the rows of ``others`` selected by the mask ``taken``, else those of ``own``."""
            return np.where(taken.reshape(-1, *[1] * (own.ndim - 1)), others, own)

        return Guess(**{name: either(value, getattr(other, name)) for name, value in vars(self).items()})


class Particles:
    """Particles of the posterior of the plumes of an episode.

    Args:
        plume: what is known before.
        white: standard deviation of a measurement.
        locations: (L, 3) in the tubes [m]; none where nobody tells.
        random: where random numbers come from.
    """

    def __init__(self, plume: WindPlume, white: float, locations: NumpyArray, random: np.random.Generator):
        self.plume = plume
        self._white, self._random = max(white, 1e-4), random
        self._locations = np.asarray(locations, np.float32)
        self._points, self._values, self._seconds = np.zeros((0, 3), np.float32), np.zeros(0), np.zeros(0)
        self._softness = SOFTNESS[0]
        middle, half = 0.5 * (plume.low + plume.high), 0.5 * INNER * (plume.high - plume.low)
        self._inner = middle - half, middle + half
        self._count = PARTICLES if len(self._locations) else UNTOLD
        self.guess = self._begun(SEARCHERS if len(self._locations) else UNTOLD)
        self._likely = self._likelihood(self.guess)
        if len(self._locations):
            self._search()

    def measured(self, points: NumpyArray, values: NumpyArray) -> None:
        """Update the particles with all measurements so far, at most once a second: values (M,) at (M, 3) [m]."""
        cells, which = np.unique(np.floor(points / CELL).astype(int), axis=0, return_inverse=True)
        which, count = which.ravel(), len(cells)
        seconds = np.bincount(which, minlength=count).astype(float)
        mean = np.bincount(which, values, count) / seconds
        middle = np.stack([np.bincount(which, points[:, i], count) / seconds for i in range(3)], axis=1)
        expected = self.concentration(middle).max(axis=0) if count > MOST_CELLS else np.zeros(count)
        says = np.argsort(-np.sqrt(seconds) * np.maximum(np.abs(mean), expected), kind="stable")[:MOST_CELLS]
        self._points, self._values, self._seconds = middle[says].astype(np.float32), mean[says], seconds[says]
        guess = self.guess
        guess.at_measured = self.plume.unit(guess.place, guess.bearings, self._points)
        self._drawn_anew(self._count)
        for _ in range(SWEEPS_LATER):
            self._sweep()

    def concentration(self, points: NumpyArray) -> NumpyArray:
        """Return the time-averaged concentration (N, P) that each particle gives at points (P, 3) NED [m]."""
        unit = self.plume.unit(self.guess.place, self.guess.bearings, np.asarray(points, np.float32))
        return self.plume.mean_rate * _summed(self.guess.rates, unit)

    def variance(self, mean: NumpyArray, seconds: NumpyArray | float) -> NumpyArray:
        """Return the variance of a concentration measured over ``seconds`` [s], for an expected value ``mean``."""
        # Puffs take some time to pass, so the first seconds say little more than one.
        relative = RELATIVE**2 + self.plume.restless / (np.asarray(seconds) + 3.0)
        return np.asarray(self._white**2 / seconds + relative * mean * mean)

    def promising(self, count: int) -> NumpyArray:
        """Return candidate positions (count, 3) NED [m] to measure at, where particles expect the plume."""
        random, guess = self._random, self.guess
        rows = random.integers(0, len(guess.bearing), count)
        slot = np.argmax(guess.there[rows] + random.uniform(size=(count, guess.there.shape[1])), axis=1)
        source, bearing = guess.place[rows, slot], guess.bearing[rows]
        along = np.exp(random.uniform(np.log(5.0), np.log(90.0), count))
        side = random.normal(0.0, 0.7, (2, count)) * np.sqrt(self.plume.spread(along))
        return source + np.stack(
            [
                np.cos(bearing) * along - np.sin(bearing) * side[0],
                np.sin(bearing) * along + np.cos(bearing) * side[0],
                side[1],
            ],
            axis=1,
        )

    def _begun(self, count: int) -> Guess:
        """Draw ``count`` first particles: sources upwind of the known locations, and winds that line several up."""
        plume, random = self.plume, self._random
        shape = count, plume.most
        guess = Guess(
            place=np.zeros((*shape, 3), np.float32),
            rate=self._random_rates(shape),
            there=np.arange(plume.most) < random.integers(plume.fewest, plume.most + 1, count)[:, None],
            bearing=self._bearings(count),
            volume=np.zeros(shape, np.float32),
            at_locations=np.zeros((*shape, len(self._locations)), np.float32),
            at_measured=np.zeros((*shape, 0), np.float32),
        )
        for slot in range(plume.most):
            guess.place[:, slot] = self._new_places(guess)
            guess.at_locations[:, slot] = plume.unit(guess.place[:, slot], guess.bearing, self._locations)
        self._weigh(guess, guess.there)
        return guess

    def _bearings(self, count: int) -> NumpyArray:
        """Draw wind bearings (N,) [rad], preferring those along which many known locations line up."""
        random = self._random
        if len(self._locations) < 2:
            return random.uniform(-np.pi, np.pi, count).astype(np.float32)
        angles = np.radians(np.arange(0.0, 180.0, 1.0))
        north, east, height = self._locations.T
        across = np.cos(angles)[:, None] * east - np.sin(angles)[:, None] * north
        beside = (across[:, :, None] - across[:, None]) ** 2 + (height[:, None] - height) ** 2
        pairs = np.exp(-0.5 * beside / BESIDE**2).sum(axis=(1, 2))
        weight = np.exp(20.0 * (pairs / pairs.max() - 1.0))
        chosen = angles[random.choice(len(angles), count, p=weight / weight.sum())]
        turned = chosen + np.pi * random.integers(0, 2, count) + random.normal(0.0, 0.01, count)
        return np.asarray(turned, np.float32)

    def _random_rates(self, shape: int | tuple[int, ...]) -> NumpyArray:
        """Draw logarithms of source release rates, an array of this shape."""
        low, high = np.log(self.plume.rates)
        return np.asarray(self._random.uniform(low, high, shape), np.float32)

    def _new_places(self, guess: Guess) -> NumpyArray:
        """Draw positions (N, 3) NED [m] of new sources: upwind of a location that no plume explains, or anywhere.

        Where nobody tells locations, upwind of where something was smelt.
        """
        random, count = self._random, len(guess.bearing)
        anywhere = random.uniform(*self._inner, (count, 3))
        smelt = self._values * np.sqrt(self._seconds) > SMELT * self._white
        if len(self._locations):
            held = _summed(guess.rates, guess.at_locations) > self._least(guess)[:, None]
            # The Gumbel trick: a random one of those that count.
            worth = np.where(held, -4.0, 0.0) + random.gumbel(size=held.shape)
            point = self._locations[np.argmax(worth, axis=1)]
        elif smelt.any():
            point = self._points[random.choice(np.flatnonzero(smelt), count)]
        else:
            return anywhere.astype(np.float32)
        back = random.exponential(UPWIND, (count, 1))
        way = np.stack([np.cos(guess.bearing), np.sin(guess.bearing), np.zeros(count)], axis=1)
        upwind = point - back * way + random.normal(0.0, BESIDE, (count, 3))
        places = np.where(random.uniform(size=(count, 1)) < ANYWHERE, anywhere, upwind)
        return np.clip(places, *self._inner).astype(np.float32)

    def _least(self, guess: Guess) -> NumpyArray:
        """Return for each particle the concentration (N,) that the known locations must exceed."""
        smallest = np.where(guess.there, guess.rate, np.inf).min(axis=1)
        return np.asarray(self.plume.threshold * np.exp(smallest), np.float32)

    def _weigh(self, guess: Guess, which: NumpyArray) -> None:
        """Recompute the volumes (N, S) of the plumes of the selected particles (``which``)."""
        which = which & guess.there
        least = self._least(guess)[:, None] / np.exp(guess.rate)
        guess.volume[which] = self.plume.volume(guess.place[which], guess.bearings[which], least[which])

    def _likelihood(self, guess: Guess) -> NumpyArray:
        """Return the log posterior density (N,) of each particle, up to a constant."""
        rates = guess.rates
        total = np.where(guess.there, guess.rate, 0.0).sum(axis=1) - PER_SOURCE * guess.there.sum(axis=1)
        if len(self._locations):
            above = np.log(np.maximum(_summed(rates, guess.at_locations), 1e-30)) - np.log(self._least(guess))[:, None]
            inside = 1.0 / (1.0 + np.exp(np.clip(-above / self._softness, -60.0, 60.0)))
            whole = np.where(guess.there, guess.volume, 0.0).sum(axis=1)
            outside = OUTLIERS / np.prod(self.plume.high - self.plume.low)
            total = total + np.log(inside / np.maximum(whole, 1.0)[:, None] + outside).sum(axis=1)
        if len(self._values):
            mean = self.plume.mean_rate * _summed(rates, guess.at_measured)
            variance = self.variance(mean, self._seconds)
            tails = 0.5 * (FREEDOM + 1.0) * np.log1p((self._values - mean) ** 2 / (FREEDOM * variance))
            total = total - np.sum(tails + 0.5 * np.log(variance), axis=1)
        return np.asarray(np.where(self._possible(guess), total, -np.inf), np.float64)

    def _possible(self, guess: Guess) -> NumpyArray:
        """Return whether all sources of each particle have allowed positions and rates, (N,) bool."""
        low, high = np.log(self.plume.rates)
        inside = np.all((guess.place >= self._inner[0]) & (guess.place <= self._inner[1]), axis=2)
        inside &= (guess.rate >= low - 1e-5) & (guess.rate <= high + 1e-5)
        return np.all(inside | ~guess.there, axis=1)

    def _search(self) -> None:
        """Fit the particles' plumes to the known locations, with soft edges at first so that small steps help."""
        for softness in SOFTNESS:
            self._softness = softness
            self._drawn_anew(SEARCHERS)
            for _ in range(SWEEPS):
                self._sweep()
        self._drawn_anew(self._count)

    def _drawn_anew(self, count: int) -> None:
        """Resample ``count`` particles, weighted by how their likelihood has changed since the last resampling."""
        likely = self._likelihood(self.guess)
        gain = likely - self._likely
        weight = np.exp(np.maximum(gain - gain.max(), -50.0))
        weight = weight / weight.sum()
        if count == len(weight) and 1.0 / np.sum(weight**2) > 0.5 * count:
            self._likely = likely
            return
        at = (np.arange(count) + self._random.uniform()) / count
        rows = np.minimum(np.searchsorted(np.cumsum(weight), at), len(weight) - 1)
        self.guess, self._likely = self.guess.picked(rows), likely[rows]

    def _sweep(self) -> None:
        """Propose and accept small changes of every particle, with a source added or removed in some."""
        for _ in range(self.plume.most):
            self._accept_moves(self._shifted())
        self._accept_moves(self._turned())
        self._accept_moves(self._replaced())

    def _accept_moves(self, proposed: Guess) -> None:
        """Accept or reject each proposed particle by the Metropolis rule."""
        likely = self._likelihood(proposed)
        taken = np.log(self._random.uniform(1e-30, 1.0, len(likely))) < likely - self._likely
        self.guess = self.guess.where(taken, proposed)
        self._likely = np.where(taken, likely, self._likely)

    def _changed(self, slot: NumpyArray, place: NumpyArray, rate: NumpyArray, there: NumpyArray) -> Guess:
        """Return the particles with source number ``slot`` (N,) set to this position, rate and existence."""
        old, new = self.guess, self.guess.copy()
        which = np.arange(len(slot)), slot
        new.place[which], new.rate[which], new.there[which] = place, rate, there
        new.at_locations[which] = self.plume.unit(new.place[which], old.bearing, self._locations)
        new.at_measured[which] = self.plume.unit(new.place[which], old.bearing, self._points)
        # Where the smallest rate is another one, all tubes are.
        self._weigh(
            new, (np.arange(new.there.shape[1]) == slot[:, None]) | (self._least(new) != self._least(old))[:, None]
        )
        return new

    def _any_slot(self) -> NumpyArray:
        """Return the index of a random existing source of each particle, (N,)."""
        there = self.guess.there
        return np.argmax(there + self._random.uniform(size=there.shape), axis=1)

    def _shifted(self) -> Guess:
        """Propose particles with one source moved at random."""
        slot, random, old = self._any_slot(), self._random, self.guess
        which = np.arange(len(slot)), slot
        # Each number has a size of step of its own: a long way along the wind goes with a short one across it.
        size = 10.0 ** random.uniform(-1.5, 0.5, (len(slot), 4))
        along, across, down, rate = (size * random.normal(size=(len(slot), 4)) * STEP).T
        sine, cosine = np.sin(old.bearing), np.cos(old.bearing)
        step = np.stack([cosine * along - sine * across, sine * along + cosine * across, down], axis=1)
        new_rate = old.rate[which] + (0.0 if self.plume.same_rates else rate)
        return self._changed(slot, old.place[which] + step, new_rate, old.there[which])

    def _replaced(self) -> Guess:
        """Propose particles with a source added, removed or placed elsewhere."""
        random, old, plume = self._random, self.guess, self.plume
        slot, count = self._any_slot(), old.there.sum(axis=1)
        kind = random.integers(0, 3, len(slot))
        more, less = (kind == 0) & (count < plume.most), (kind == 1) & (count > plume.fewest)
        rate = self._random_rates(len(slot))
        return self._changed(np.where(more, np.argmin(old.there, axis=1), slot), self._new_places(old), rate, ~less)

    def _turned(self) -> Guess:
        """Propose particles with another wind bearing, their sources turned about the centres of their plumes."""
        old, random, plume = self.guess, self._random, self.plume
        turn = TURN * 10.0 ** random.uniform(-2.0, 0.5, len(old.bearing)) * random.normal(size=len(old.bearing))
        new = old.copy()
        new.bearing = (old.bearing + turn).astype(np.float32)
        half = 0.5 * plume.reach(old.place, old.bearings)
        new.place[..., 0] += half * (np.cos(old.bearing) - np.cos(new.bearing))[:, None]
        new.place[..., 1] += half * (np.sin(old.bearing) - np.sin(new.bearing))[:, None]
        new.at_locations = plume.unit(new.place, new.bearings, self._locations)
        new.at_measured = plume.unit(new.place, new.bearings, self._points)
        self._weigh(new, new.there)
        return new


def _summed(rates: NumpyArray, unit: NumpyArray) -> NumpyArray:
    """Return the total concentration (N, P) of sources with rates (N, S), from theirs at rate 1 (N, S, P)."""
    return np.einsum("ns,nsp->np", rates, unit)
