"""A store as read: parameters and metrics of its episodes, for any dimensions."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import RunError, UsageError, did_you_mean, did_you_mean_file, shortened
from qrsim.files import Content
from qrsim.scenarios.reading import parse_yaml
from qrsim.studies.sweep.metrics import METRICS
from qrsim.studies.sweep.plan import TRACK
from qrsim.studies.sweep.store import FLOWN, KIND
from qrsim.studies.sweep.study import StudySpec

# More values of a parameter than these are put together in so many classes of equal size.
MOST_LEVELS, CLASSES = 30, 12


@dataclass(frozen=True)
class Parameter:
    """A parameter over all E episodes.

    Attributes:
        name: of the dimension or coordinate.
        unit: "" where it is not known.
        levels: (L,) its values, numbers or texts; of a sampled one the mean of each class.
        level: (E,) number of the level of each episode.
        values: (E,) its value in each episode, of texts the number of the level.
        numeric: whether it is a number.
        sampled: whether levels are classes of a sample.
        log: whether it is spread evenly in its logarithm.
    """

    name: str
    unit: str
    levels: NumpyArray
    level: NumpyArray
    values: NumpyArray
    numeric: bool
    sampled: bool
    log: bool

    def even(self, values: NumpyArray) -> NumpyArray:
        """Map the parameter's values to its even scale: logarithms for a logarithmic parameter."""
        return np.log(values) if self.log else values

    def uneven(self, values: NumpyArray) -> NumpyArray:
        """Map values on the parameter's even scale back: the exponential for a logarithmic parameter."""
        return np.exp(values) if self.log else values

    @property
    def label(self) -> str:
        """Name and unit of the parameter, for the axis of a figure."""
        return f"{self.name} [{self.unit}]" if self.unit and self.unit != "1" else self.name


class Results:
    """The episodes that are in a store.

    Args:
        path: of the store.

    Raises:
        UsageError: it is none.
        RunError: nothing has been flown yet, or it is damaged.
    """

    def __init__(self, path: Path):
        import xarray as xr

        if not path.exists():
            raise UsageError(f"{path}: there is no such store; 'qrsim sweep STUDY' writes one{did_you_mean_file(path)}")
        try:
            self.dataset = xr.open_zarr(path, consolidated=False, chunks=None)
        except (OSError, ValueError, KeyError) as error:
            raise UsageError(f"{path}: it is no store of a sweep: {error}") from None
        if self.dataset.attrs.get("kind") != KIND:
            raise UsageError(f"{path}: it is no store of a sweep")
        self.path = path
        self.flown = self.dataset[FLOWN].values.ravel()
        if not self.flown.any():
            raise RunError(f"{path}: no episode has been flown yet")
        attributes = self.dataset.attrs
        try:
            self.scenario: Content = parse_yaml(attributes["scenario"], str(path), own=True)
            self.spec = StudySpec.model_validate({**json.loads(attributes["study"]), "scenario": attributes["source"]})
            self.source: str | None = attributes["source"] or None
        except (KeyError, TypeError, ValueError) as error:  # a ScenarioError and pydantic's are ValueErrors
            raise RunError(f"{path}: the store is damaged: {shortened(str(error), 300)}") from None

    @property
    def episodes(self) -> int:
        """Number of episodes, E, that are in the store."""
        return int(self.flown.sum())

    @property
    def planned(self) -> int:
        """Number of episodes that the study has in all."""
        return len(self.flown)

    @cached_property
    def seeds(self) -> NumpyArray:
        """Seed (E,) of each episode."""
        first: NumpyArray = self._spread("seed")[self.flown]
        sampling = self.spec.sampling
        return first + self.points if sampling is not None and sampling.paired else first

    @cached_property
    def positions(self) -> NumpyArray:
        """Flat index (E,) of each episode in the Dataset."""
        return np.flatnonzero(self.flown)

    @cached_property
    def points(self) -> NumpyArray:
        """Index (E,) of each episode's point (condition)."""
        return self.positions // self.dataset.sizes["seed"]

    def metric(self, name: str) -> NumpyArray:
        """Return the values (E,) of a metric in all E episodes.

        Raises:
            UsageError: the store does not have it.
        """
        known = [str(key) for key in self.dataset.data_vars if key not in (FLOWN, TRACK)]
        if name not in known:
            raise UsageError(f"{self.path}: no metric is called '{name}'{did_you_mean(name, known)}")
        found: NumpyArray = self.dataset[name].values.ravel()[self.flown].astype(np.float64)
        return found

    @cached_property
    def tracks(self) -> NumpyArray:
        """North, east, down [m] and charge (E, R, n, 4) of vehicles at R equal intervals; NaN after the end of a run.

        Raises:
            UsageError: the study keeps none.
        """
        if TRACK not in self.dataset:
            raise UsageError(f"{self.path}: it has no tracks; its study needs track, an interval in seconds")
        found: NumpyArray = self.dataset[TRACK].values.reshape(len(self.flown), *self.dataset[TRACK].shape[-3:])
        return found[self.flown]

    def unit(self, metric: str) -> str:
        """Return the unit of a metric; "1" for counts."""
        return str(self.dataset[metric].attrs["units"])

    def limits(self, metric: str) -> tuple[float, float]:
        """Return (low, high), between which a metric lies by definition."""
        return METRICS[metric].limits if metric in METRICS else (-math.inf, math.inf)

    def low_is_bad(self, metric: str) -> bool:
        """Return whether small values of a metric are worse than large ones."""
        # A store of an earlier version does not say so itself.
        known = METRICS[metric].low_is_bad if metric in METRICS else False
        return bool(self.dataset[metric].attrs.get("low_is_bad", known))

    @cached_property
    def failed(self) -> NumpyArray:
        """Return a mask (E,) of episodes that failed; episodes without the metric count as not failed."""
        failure = self.spec.failure
        values = self.metric(failure.metric)
        if failure.above is not None:
            return values > failure.above
        return values < failure.below

    @property
    def failure(self) -> str:
        """Definition of a failure, as text."""
        failure = self.spec.failure
        limit, word = (failure.above, ">") if failure.above is not None else (failure.below, "<")
        unit = self.unit(failure.metric)
        return f"{failure.metric} {word} {limit:g}{'' if unit == '1' else f' {unit}'}"

    def _spread(self, name: str) -> NumpyArray:
        """Return a coordinate of the Dataset for every planned episode, as a flat array."""
        return np.broadcast_to(
            self.dataset[name].broadcast_like(self.dataset[FLOWN]).transpose(*self.dataset[FLOWN].dims).values,
            self.dataset[FLOWN].shape,
        ).ravel()

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """Varied parameters of the study by name, in its order."""
        names = [item.name or path for path, item in self.spec.vary.items()]
        return {name: self._parameter(name) for name in names}

    def _parameter(self, name: str) -> Parameter:
        """Return a parameter from the store, with its levels and the index of each episode's level."""
        coordinate = self.dataset[name]
        unit = str(coordinate.attrs.get("units", ""))
        numeric = coordinate.dtype.kind in "fiu"
        own = np.asarray(coordinate.values)
        if numeric:
            levels, level = np.unique(own, return_inverse=True)
        else:
            # In the order of the study.
            texts = list(dict.fromkeys(own.tolist()))
            levels, level = np.array(texts, dtype=object), np.array([texts.index(text) for text in own.tolist()])
        sampled = numeric and len(levels) > MOST_LEVELS
        if sampled:
            rank = np.argsort(np.argsort(own, kind="stable"), kind="stable")
            level = rank * CLASSES // len(own)
            levels = np.array([own[level == i].mean() for i in range(CLASSES)])
        at = self._spread_index(name)
        values = own[at] if numeric else level[at].astype(float)
        log = any((item.name or path) == name and item.scale == "log" for path, item in self.spec.vary.items())
        return Parameter(name, unit, levels, level[at], np.asarray(values, np.float64), numeric, sampled, log)

    def _spread_index(self, name: str) -> NumpyArray:
        """Return each episode's index (E,) along the dimension of a coordinate of the Dataset."""
        flown = self.dataset[FLOWN]
        (dimension,) = self.dataset[name].dims
        axis = flown.dims.index(dimension)
        return np.unravel_index(self.positions, flown.shape)[axis]

    def values_at(self, episode: int) -> Content:
        """Return path -> value of each varied parameter in an episode, in the scenario's terms."""
        found: Content = {}
        for path, item in self.spec.vary.items():
            index = int(self._spread_index(item.name or path)[episode])
            if item.listed is not None:
                found[path] = item.listed[index]
            else:
                found[path] = float(self.dataset[item.name or path].values[index])
        return found

    def summary(self) -> Content:
        """Return the number of episodes planned and stored, with the study's name."""
        return {
            "study": self.spec.name,
            "episodes": self.episodes,
            "planned": self.planned,
            "points": math.prod(self.dataset[FLOWN].shape[:-1]),
            "failed": int(self.failed.sum()),
            "failure": self.failure,
        }
