"""Plume mapping by a fit of the plume's parameters, flying to the most informative positions."""

from __future__ import annotations

from typing import Protocol, cast

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.models.scene.plume import GaussianPlume
from qrsim.models.sensors.concentration import ConcentrationSensor
from qrsim.tasks.agents import number_of
from qrsim.tasks.baselines.ellipsoids import Ellipsoids
from qrsim.tasks.baselines.particles import Particles
from qrsim.tasks.baselines.puffs import puff_samples
from qrsim.tasks.baselines.separation import apart
from qrsim.tasks.baselines.tubes import WindPlume
from qrsim.tasks.play import Play
from qrsim.tasks.plume_mapping import PlumeMapping

# Steps between two fits, each of which tells the vehicles where to fly.
EVERY = 40
# Places that are looked at, how long [s] a vehicle is thought to measure there, and what any flight costs [s].
CANDIDATES, STAY, PAUSE = 240, 15.0, 20.0
# Vehicles keep so far [m] from walls and ceiling and from the ground, their targets and they from each other.
WALL, GROUND, TARGETS_APART, SEPARATION = 12.0, 6.0, 25.0, 16.0
# They keep apart where they will be after so long [s].
AHEAD_S = 1.0
# How fast places are made good [1/s], and how fast it is learned what the wind adds to a velocity, a step.
GAIN, LEARN, MOST_DRIFT = 0.5, 0.1, 1.5


class Fit(Protocol):
    """Guesses (G,) of an episode's plume, about equally likely."""

    def measured(self, points: NumpyArray, values: NumpyArray) -> None:
        """Fit the guesses of the plume to all concentrations measured so far, values (M,) at points (M, 3) [m]."""

    def concentration(self, points: NumpyArray) -> NumpyArray:
        """Return the mean concentration (G, P) that each of the G plume guesses gives at points (P, 3) NED [m]."""
        ...

    def variance(self, mean: NumpyArray, seconds: NumpyArray | float) -> NumpyArray:
        """Return the variance of a concentration measured over ``seconds`` [s], for an expected value ``mean``."""
        ...

    def promising(self, count: int) -> NumpyArray:
        """Return candidate positions (count, 3) NED [m] to measure at, where guesses expect the plume."""
        ...


class Mapping:
    """Policy with a fit of the plume to the task's locations and to measurements.

    It knows what a scenario says of a plume, and not what an episode draws. Each vehicle flies to the place where a
    measurement would leave least doubt about the concentration at the locations, for its distance.
    """

    def __init__(self, play: Play, seed: int = 0):
        area = play.world.area
        bounds = np.array([[float(getattr(area, f"{axis}_{end}")) for end in ("min", "max")] for axis in "xyz"])
        # No more than a third of a small box is kept clear of at each side.
        margin = np.minimum([[WALL, WALL], [WALL, WALL], [WALL, GROUND]], (bounds[:, 1:] - bounds[:, :1]) / 3.0)
        self._low, self._high = bounds[:, 0] + margin[:, 0], bounds[:, 1] - margin[:, 1]
        self._random = np.random.default_rng(seed)
        self._play = play
        self._points: list[NumpyArray] = []
        self._values: list[NumpyArray] = []
        self._fit: Fit | None = None
        self._locations = np.zeros((0, 3))
        self._target = np.zeros((0, 3))
        self._drift: NumpyArray | None = None
        self._limit = float(play.axes[0].high)

    def act(self, seen: dict[str, NumpyArray]) -> NumpyArray:
        """Return actions (n, 3), scaled velocities towards places where measurements tell most about the plume."""
        vehicle = np.asarray(seen["vehicle"], np.float64)
        place, velocity = vehicle[:, :3], vehicle[:, 3:6]
        if self._fit is None:
            self._locations = np.asarray(seen["locations"][0], np.float64)
            self._fit = self._begun()
        if self._drift is None:
            self._drift, self._asked = np.zeros_like(place), velocity
        self._points.append(place)
        self._values.append(vehicle[:, -1])
        if len(self._points) % EVERY == 1:
            if len(self._points) > 1:
                self._update_fit()
            self._target = self._targets(place)
        # A steady wind leaves less than what is asked for.
        self._drift = np.clip(self._drift + LEARN * (self._asked - velocity - self._drift), -MOST_DRIFT, MOST_DRIFT)
        wanted = GAIN * (self._target - place)
        wanted *= np.minimum(1.0, self._limit / np.maximum(np.abs(wanted).max(axis=1, keepdims=True), 1e-9))
        self._asked = np.clip(wanted + apart(place + AHEAD_S * velocity, SEPARATION), -self._limit, self._limit)
        return np.clip((self._asked + self._drift) / self._limit, -1.0, 1.0)

    def answer(self) -> NumpyArray:
        """Return each agent's answer at the end: expected concentrations at the locations, or samples for puffs."""
        self._update_fit()
        assert self._fit is not None
        shape = self._play.task.answer_shape(self._play.world)
        if len(shape) == 1:
            found = self._fit.concentration(self._locations).mean(axis=0)
        else:
            assert isinstance(self._fit, Particles)
            rows = self._random.integers(0, len(self._fit.guess.bearing), shape[1])
            guess, plume = self._fit.guess.picked(rows), self._play.world.contents.plume
            found = puff_samples(self._fit.plume, plume, guess, self._locations, self._random)
        return np.broadcast_to(found, (len(self._play.agents), *shape)).copy()

    def _begun(self) -> Fit:
        """Return the first fit of the plume, from locations that are known to be in it."""
        play, task = self._play, cast(PlumeMapping, self._play.task)
        fleet = play.world.fleets[number_of(play.world, play.task.fleet)]
        sensor = fleet.sensors[fleet.sensor_names.index(task.sensor)]
        white = float(sensor.white_std) if isinstance(sensor, ConcentrationSensor) else 0.0
        told = self._locations[task.anywhere :]
        if isinstance(play.world.contents.plume, GaussianPlume):
            return Ellipsoids(play, white, told, self._random)
        return Particles(WindPlume.of(play), white, told, self._random)

    def _update_fit(self) -> None:
        """Refit the plume to all measurements of concentration so far."""
        assert self._fit is not None
        self._fit.measured(np.concatenate(self._points), np.concatenate(self._values))

    def _targets(self, place: NumpyArray) -> NumpyArray:
        """Return each vehicle's next position (n, 3) to measure at: the best of several, none near another's."""
        assert self._fit is not None
        places = np.clip(self._fit.promising(CANDIDATES), self._low, self._high)
        there, asked = self._fit.concentration(places), self._fit.concentration(self._locations)
        mean = there.mean(axis=0)
        there, asked = there - mean, asked - asked.mean(axis=0)
        common = there.T @ asked / len(there)
        # By so much a measurement makes the sum of the variances at the locations smaller.
        worth = np.sum(common**2, axis=1) / (np.mean(there**2, axis=0) + self._fit.variance(mean, STAY))
        found = np.clip(place, self._low, self._high)
        for i in range(len(place)):
            time = PAUSE + np.linalg.norm(places - place[i], axis=1) / self._limit
            best = int(np.argmax(worth / time))
            # Where no place is left, a vehicle stays.
            if worth[best] >= 0.0:
                found[i] = places[best]
            worth = np.where(np.linalg.norm(places - found[i], axis=1) < TARGETS_APART, -np.inf, worth)
        return found
