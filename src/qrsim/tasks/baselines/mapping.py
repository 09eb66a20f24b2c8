"""Plume mapping by a Gaussian process (scikit-learn), flying to where it is unsure or where much is to be expected."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from qrsim.errors import UsageError
from qrsim.tasks.baselines.separation import apart
from qrsim.tasks.play import Play

Array = np.ndarray[Any, Any]
# Scale [m] of the process along north, east and down, and the noise of a measurement beside its signal.
LENGTHS, NOISE = (14.0, 14.0, 10.0), 0.03
EVERY, MOST_POINTS, CANDIDATES = 40, 250, 200
GAIN, SEPARATION = 0.5, 10.0
# How much more than the spread the mean is worth.
GREED = 2.0


class Mapping:
    """A Gaussian process of what was measured; each vehicle flies to the place that promises most for its distance."""

    def __init__(self, play: Play, seed: int = 0):
        try:
            from sklearn.gaussian_process import GaussianProcessRegressor
            from sklearn.gaussian_process.kernels import RBF, WhiteKernel
        except ModuleNotFoundError:
            raise UsageError("policy baseline: scikit-learn is not installed; install qrsim[envs]") from None
        self._make: Any = lambda: GaussianProcessRegressor(RBF(LENGTHS) + WhiteKernel(NOISE), optimizer=None)
        area = play.world.area
        bounds = [(float(getattr(area, f"{axis}_min")), float(getattr(area, f"{axis}_max"))) for axis in "xyz"]
        self._low, self._high = np.array(bounds).T
        margin = 0.06 * (self._high - self._low)
        self._low, self._high = self._low + margin, self._high - margin
        self._random = np.random.default_rng(seed)
        self._play = play
        self._points: list[Array] = []
        self._values: list[float] = []
        self._target: Array | None = None
        self._since = 0
        self._process: Any = None
        self._scale = 1.0
        self._locations: Array | None = None
        self._limit = float(play.task.axes[0].high)

    def act(self, seen: dict[str, Array]) -> Array:
        """Return the actions (n, 3)."""
        vehicle = np.asarray(seen["vehicle"], np.float64)
        place, smelt = vehicle[:, :3], vehicle[:, -1]
        self._locations = np.asarray(seen["locations"][0], np.float64)
        self._points += list(place)
        self._values += list(smelt)
        if self._target is None:
            self._target = place.copy()
        arrived = np.linalg.norm(self._target - place, axis=1) < 4.0
        if arrived.any() or self._since >= EVERY:
            self._fit()
            for i in np.flatnonzero(arrived) if arrived.any() else range(len(place)):
                self._target[i] = self._next(int(i), place)
            self._since = 0
        self._since += 1
        offset = self._target - place
        wanted = GAIN * offset
        wanted *= np.minimum(1.0, self._limit / np.maximum(np.abs(wanted).max(axis=1, keepdims=True), 1e-9))
        return np.clip((wanted + apart(place, SEPARATION)) / self._limit, -1.0, 1.0)

    def answer(self) -> Array:
        """Return what each agent hands in: the mean, or samples with that mean."""
        self._fit()
        assert self._locations is not None
        mean = np.maximum(self._process.predict(self._locations) * self._scale, 0.0)
        shape = self._play.task.answer_shape(self._play.world)
        if len(shape) == 1:
            found = mean
        else:
            # Puffs come and go: of a mean m they make something like an exponential distribution.
            found = self._random.exponential(np.maximum(mean, 1e-4)[:, None], shape)
        return np.broadcast_to(found, (len(self._play.agents), *shape)).copy()

    def _fit(self) -> None:
        points, values = np.array(self._points), np.array(self._values)
        if len(points) > MOST_POINTS:
            # What stands out is kept, of the rest a random part.
            loud = np.argsort(-np.abs(values))[: MOST_POINTS // 2]
            rest = self._random.choice(np.setdiff1d(np.arange(len(points)), loud), MOST_POINTS // 2, replace=False)
            points, values = points[np.r_[loud, rest]], values[np.r_[loud, rest]]
        self._scale = max(float(np.abs(values).max()), 1e-3)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._process = self._make().fit(points, values / self._scale)

    def _next(self, i: int, place: Array) -> Array:
        """Return where a vehicle is to fly: of some random places the best, none that another flies to."""
        assert self._target is not None
        near = place[i] + self._random.normal(0.0, 20.0, (CANDIDATES // 3, 3))
        anywhere = self._random.uniform(self._low, self._high, (CANDIDATES - len(near), 3))
        places = np.clip(np.concatenate([near, anywhere]), self._low, self._high)
        mean, spread = self._process.predict(places, return_std=True)
        worth = spread + GREED * np.maximum(mean, 0.0) * spread
        for j in range(len(place)):
            if j != i:
                worth = np.where(np.linalg.norm(places - self._target[j], axis=1) < 30.0, 0.1 * worth, worth)
        chosen: Array = places[int(np.argmax(worth / (20.0 + np.linalg.norm(places - place[i], axis=1))))]
        return chosen
