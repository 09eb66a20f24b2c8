"""Samples of the concentration of puffs at given points, for known or guessed sources."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.models.scene.plume import PuffPlume, trail
from qrsim.tasks.baselines.particles import Guess
from qrsim.tasks.baselines.tubes import WindPlume


def puff_samples(
    known: WindPlume, puffs: PuffPlume, guess: Guess, points: NumpyArray, random: np.random.Generator
) -> NumpyArray:
    """Draw concentrations (P, N) at points (P, 3) NED [m]: a random moment of the puffs of each particle of ``guess``.

    Releases are independent of each other, so those in the air at a moment are a random number of random ages.
    """
    points = np.asarray(points, np.float32)
    total = np.zeros((len(guess.bearing), len(points)), np.float32)
    for slot in range(guess.place.shape[1]):
        place, bearing = guess.place[:, slot], guess.bearing
        reach = known.reach(place, bearing)
        # A puff is looked at until what trails behind it has left the box.
        end = reach + np.asarray(trail(known.factor, known.exponent, jnp.asarray(reach)))
        count = np.where(guess.there[:, slot], random.poisson(end / (known.speed * float(puffs.gap))), 0)
        shape = len(count), int(count.max(initial=0))
        flown = (end[:, None] * random.uniform(size=shape)).astype(np.float32)
        amount = random.uniform(float(puffs.amount_min), float(puffs.amount_max), shape)
        amount = np.where(np.arange(shape[1]) < count[:, None], amount, 0.0).astype(np.float32)
        along, _ = known.along_across(place, bearing, points)
        spread = known.spread(along)
        # Released at once, not in a second, so a puff is as a plume of rate 1 times this.
        unit = known.unit(place, bearing, points) * known.speed / np.sqrt(np.pi * spread)
        passing = np.zeros_like(total)
        for number in range(shape[1]):
            behind = along - flown[:, number, None]
            passing += amount[:, number, None] * np.exp(-behind * behind / spread)
        total += unit * passing
    return total.T
