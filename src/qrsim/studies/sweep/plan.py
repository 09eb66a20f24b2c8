"""A study cut into batches, each a block of its Dataset, computed on demand."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError
from qrsim.files import Content
from qrsim.studies.sweep.axes import Axis
from qrsim.studies.sweep.groups import Group
from qrsim.studies.sweep.sampling import Sample
from qrsim.studies.sweep.study import BASELINE, Study
from qrsim.world.state import period_ticks

SEED, POINT, TRACK = "seed", "point", "track"
# A batch is about a second of work for a core, and a small study has some batches all the same.
VEHICLE_TICKS, FEWEST_BATCHES, MOST_VEHICLES = 3_000_000, 16, 4096
TASK_EPISODES = 4


@dataclass(frozen=True)
class Batch:
    """Some episodes, a block of the Dataset.

    Attributes:
        index: of the batch.
        region: of the Dataset.
        shape: of the block.
        group: key of the group that its conditions belong to.
        numbers: value of each number that varies, (W,) each.
        seeds: (W,) of the episodes.
    """

    index: int
    region: tuple[slice, ...]
    shape: tuple[int, ...]
    group: tuple[int, ...]
    numbers: dict[str, NumpyArray]
    seeds: NumpyArray

    @property
    def episodes(self) -> int:
        """Number of episodes in the batch, W."""
        return len(self.seeds)


class Plan:
    """The episodes of a study, by ranges of their indices.

    Args:
        study: what is studied.
        axes: what varies.
        structural: paths of the axes whose values change what is compiled.
        groups: by the indices of the values of these axes, in their order.
    """

    def __init__(
        self, study: Study, axes: tuple[Axis, ...], structural: tuple[str, ...], groups: Mapping[tuple[int, ...], Group]
    ):
        self.study, self.axes, self.groups = study, axes, groups
        self.structural = structural
        sampling = study.spec.sampling
        self.listed = sampling is not None and sampling.type == "list"
        self.sampled = tuple(axis for axis in axes if self.listed or axis.values is None)
        self.crossed = tuple(axis for axis in axes if axis not in self.sampled)
        self.sample = Sample(sampling, len(self.sampled)) if sampling and not self.listed else None

    @cached_property
    def dims(self) -> tuple[str, ...]:
        """Names of the Dataset's dimensions: crossed parameters, sampled points, seeds."""
        names = [axis.name for axis in self.crossed]
        return (*names, *([POINT] if self.sampled else []), SEED)

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Size of each dimension of the Dataset."""
        sizes = [len(axis.values or ()) for axis in self.crossed]
        if self.sample is not None:
            sizes.append(self.sample.size)
        elif self.listed:
            sizes.append(len(self.sampled[0].values or ()))
        return (*sizes, self.study.spec.seeds)

    @cached_property
    def track(self) -> tuple[int, ...]:
        """Shape of an episode's track: records, vehicles, 4 (north, east, down, charge); () without tracks."""
        every = self.study.spec.track
        if every is None:
            return ()
        groups = self.groups.values()
        records = {group.ticks // period_ticks(every, group.time_step) + 1 for group in groups}
        vehicles = {group.vehicles for group in groups}
        if len(records) > 1 or len(vehicles) > 1:
            raise UsageError("track: all conditions need one duration and the same vehicles")
        return records.pop(), vehicles.pop(), 4

    @property
    def points(self) -> int:
        """Number of points (conditions) of the study, without seeds."""
        return math.prod(self.shape[:-1])

    @property
    def episodes(self) -> int:
        """Number of episodes of the study."""
        return math.prod(self.shape)

    @cached_property
    def chunks(self) -> tuple[int, ...]:
        """Size of a batch along each dimension of the Dataset."""
        single = [axis.path in self.structural for axis in self.crossed]
        if self.sampled:
            single.append(any(axis.path in self.structural for axis in self.sampled))
        left, found = self._wanted, []
        for size, alone in zip(reversed(self.shape), [False, *reversed(single)], strict=True):
            step = 1 if alone else min(size, max(1, left))
            found.append(step)
            # Only the last dimension that is cut is cut in parts of more than one.
            left = left // step if step == size else 1 if not alone else left
        return tuple(reversed(found))

    @property
    def _wanted(self) -> int:
        """Return how many episodes a batch should have."""
        if self.study.spec.batch:
            return self.study.spec.batch
        if self.study.spec.policy == BASELINE:
            return TASK_EPISODES
        largest = max(group.vehicles * group.ticks for group in self.groups.values())
        vehicles = max(group.vehicles for group in self.groups.values())
        wanted = min(VEHICLE_TICKS // largest, MOST_VEHICLES // vehicles, -(-self.episodes // FEWEST_BATCHES))
        return max(1, wanted)

    @cached_property
    def grid(self) -> tuple[int, ...]:
        """Number of batches along each dimension of the Dataset."""
        return tuple(-(-size // step) for size, step in zip(self.shape, self.chunks, strict=True))

    @property
    def batches(self) -> int:
        """Number of batches of the study."""
        return math.prod(self.grid)

    def region(self, index: int) -> tuple[slice, ...]:
        """Return the region of the Dataset, a slice per dimension, that batch ``index`` fills."""
        corner = np.unravel_index(index, self.grid)
        return tuple(
            slice(int(at) * step, min(size, (int(at) + 1) * step))
            for at, step, size in zip(corner, self.chunks, self.shape, strict=True)
        )

    def batch(self, index: int) -> Batch:
        """Return batch ``index``: its group, region of the Dataset, varied numbers and seeds."""
        region = self.region(index)
        shape = tuple(part.stop - part.start for part in region)
        chosen: dict[str, int] = {}
        numbers: dict[str, NumpyArray] = {}
        for axis, values, dimension in self._columns(region):
            if axis.path in self.structural:
                chosen[axis.path] = int(values[0])
                continue
            view = values.reshape([-1 if i == dimension else 1 for i in range(len(shape))])
            numbers[axis.path] = np.ascontiguousarray(np.broadcast_to(view, shape)).reshape(-1)
        part = region[-1]
        seeds = self.study.spec.first_seed + np.arange(part.start, part.stop, dtype=np.int64)
        if self.sample is not None and self.sample.spec.paired:
            point = region[len(self.crossed)]
            seeds = seeds + np.arange(point.start, point.stop, dtype=np.int64)[:, None]
        seeds = np.ascontiguousarray(np.broadcast_to(seeds, shape)).reshape(-1)
        return Batch(index, region, shape, tuple(chosen[path] for path in self.structural), numbers, seeds)

    def _columns(self, region: tuple[slice, ...]) -> Iterator[tuple[Axis, NumpyArray, int]]:
        """Yield (axis, its values in a region of the Dataset, dimension); indices in place of structural values."""
        for dimension, axis in enumerate(self.crossed):
            yield axis, self._of(axis, region[dimension]), dimension
        if self.sampled:
            part = region[len(self.crossed)]
            rows = self.rows(part.start, part.stop)
            for axis in self.sampled:
                yield axis, rows[axis.path], len(self.crossed)

    def _of(self, axis: Axis, part: slice) -> NumpyArray:
        """Return the values of an axis in the slice ``part``; indices of the values if the axis is structural."""
        assert axis.values is not None
        if axis.path in self.structural:
            return np.arange(part.start, part.stop)
        return np.array(axis.values)[part]

    def rows(self, start: int, stop: int) -> dict[str, NumpyArray]:
        """Return path -> values of sampled parameters at points ``start`` to ``stop``; indices for structural ones."""
        if self.sample is None:
            return {axis.path: self._of(axis, slice(start, stop)) for axis in self.sampled}
        unit = self.sample.rows(start, stop)
        return {axis.path: axis.scaled(unit[:, i]) for i, axis in enumerate(self.sampled)}

    def values_at(self, position: tuple[int, ...]) -> dict[str, object]:
        """Return path -> value of each parameter at an index of the Dataset, in the scenario's terms."""
        found: dict[str, object] = {}
        for dimension, axis in enumerate(self.crossed):
            assert axis.values is not None
            found[axis.path] = axis.values[position[dimension]]
        if self.sampled:
            point = position[len(self.crossed)]
            rows = {} if self.listed else self.rows(point, point + 1)
            for axis in self.sampled:
                found[axis.path] = axis.values[point] if axis.values else float(rows[axis.path][0])
        return {axis.path: found[axis.path] for axis in self.axes}


def choices(axes: tuple[Axis, ...], listed: bool) -> Iterator[tuple[tuple[int, ...], Content]]:
    """Yield (indices, path -> value) for each combination of structural axes; ``listed``: axes vary together."""
    lengths = [len(axis.values or ()) for axis in axes]
    indices = ((i,) * len(axes) for i in range(lengths[0])) if listed and axes else product(*map(range, lengths))
    for chosen in indices:
        yield tuple(chosen), {axis.path: (axis.values or ())[i] for axis, i in zip(axes, chosen, strict=True)}
