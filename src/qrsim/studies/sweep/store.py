"""Store of results: an xarray Dataset in Zarr, one chunk of each variable per batch.

A batch is in the store when ``flown`` says so of its episodes, and that is written last; every file appears whole or
not at all. So whatever ends the process, what is there can be read, and what is missing is known.
"""

from __future__ import annotations

import errno
import json
import math
import os
import shutil
import warnings
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from qrsim.core.arrays import NumpyArray
from qrsim.errors import RunError, UsageError, os_error_as
from qrsim.files import Content
from qrsim.scenarios.reading import dump_yaml
from qrsim.studies.sweep.axes import Axis
from qrsim.studies.sweep.plan import POINT, SEED, TRACK, Batch, Plan
from qrsim.studies.sweep.provenance import differences, versions

FLOWN, KIND = "flown", "qrsim sweep"
# Points of a sample whose values are computed and written at once.
ROWS = 65_536
MOST_DIFFERENCES = 8


class Store:
    """The results of a study on disk, with one writing process.

    Args:
        path: of the folder.
        plan: of the study.

    Raises:
        UsageError: what is there is something else, the store of another study, or of other versions.
        RunError: it cannot be written, or another process writes to it.
    """

    def __init__(self, path: Path, plan: Plan):
        self.path, self.plan = path, plan
        self.metrics = _metrics(plan)
        self._open = ExitStack()
        with os_error_as(RunError, f"{path}: the store cannot be written"):
            if path.exists():
                _refuse_other(path, plan)
                self._lock()
                _tidy(path)
                self._say_anew()
            else:
                self._create()
                self._lock()
            self._group: Any = zarr.open_group(path, mode="r+")
            self.done = self._done()

    def close(self) -> None:
        """Release the store for other writers."""
        self._open.close()

    def _lock(self) -> None:
        """Lock the store for this process; raise RunError if another process writes to it."""
        try:
            import fcntl
        except ImportError:  # no such locks on this system
            return
        handle = os.open(self.path, os.O_RDONLY)
        self._open.callback(os.close, handle)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RunError(f"{self.path}: another process writes to this store") from None

    def _create(self) -> None:
        """Create an empty store of results in a temporary folder and move it into place."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        beside = self.path.with_name(f".{self.path.name}.{os.getpid()}.new")
        try:
            self._write_frame(beside)
            beside.rename(self.path)
        except BaseException:
            shutil.rmtree(beside, ignore_errors=True)
            raise

    def _say_anew(self) -> None:
        """Update the store's attributes, descriptions and limits to those of the present plan."""
        group, about = zarr.open_group(self.path, mode="r+"), _attributes(self.plan)
        if dict(group.attrs) != about:
            group.attrs.update(about)

    def _write_frame(self, path: Path) -> None:
        """Create the Zarr group of a store: an empty array for each metric, and the coordinates."""
        plan = self.plan
        group = zarr.create_group(path, zarr_format=3, attributes=_attributes(plan))
        coordinates = [axis.name for axis in plan.sampled]
        for name in self.metrics:
            metric = plan.study.metric(name)
            about = {
                "units": metric.unit,
                "long_name": metric.doc,
                "low_is_bad": metric.low_is_bad,
                "coordinates": " ".join(coordinates),
            }
            self._array(group, name, "float32", math.nan, about if coordinates else _without(about, "coordinates"))
        if plan.track:
            self._write_track(group)
        about = {"long_name": "whether the episode is in the store", "coordinates": " ".join(coordinates)}
        self._array(group, FLOWN, "bool", False, about if coordinates else _without(about, "coordinates"))
        seeds = plan.study.spec.first_seed + np.arange(plan.study.spec.seeds, dtype=np.int64)
        _coordinate(group, SEED, SEED, seeds, {"long_name": "seed of 'qrsim run --seed'"})
        for axis in plan.crossed:
            _coordinate(group, axis.name, axis.name, axis.labels, _about(axis))
        if plan.sampled:
            self._write_points(group)

    def _write_track(self, group: Any) -> None:
        """Create the empty Zarr array of recorded tracks."""
        plan = self.plan
        group.create_array(
            TRACK,
            shape=(*plan.shape, *plan.track),
            chunks=(*plan.chunks, *plan.track),
            dtype="float32",
            fill_value=math.nan,
            dimension_names=(*plan.dims, "record", "vehicle", "number"),
            attributes={"long_name": "north, east, down [m] and charge", "interval_s": plan.study.spec.track},
        )

    def _write_points(self, group: Any) -> None:
        """Create the coordinates of sampled points in the Zarr group, and write their values."""
        plan = self.plan
        count = plan.shape[len(plan.crossed)]
        _coordinate(group, POINT, POINT, np.arange(count), {"long_name": "number of the point"})
        if plan.listed:
            for axis in plan.sampled:
                _coordinate(group, axis.name, POINT, axis.labels, _about(axis))
            return
        arrays = {
            axis.path: group.create_array(
                axis.name,
                shape=(count,),
                chunks=(min(count, ROWS),),
                dtype="float64",
                fill_value=math.nan,
                dimension_names=(POINT,),
                attributes=_about(axis),
            )
            for axis in plan.sampled
        }
        for start in range(0, count, ROWS):
            stop = min(count, start + ROWS)
            for path, values in plan.rows(start, stop).items():
                arrays[path][start:stop] = values

    def _array(self, group: Any, name: str, dtype: str, fill: object, attributes: Mapping[str, object]) -> None:
        """Create an empty Zarr array over all episodes, one chunk per batch."""
        group.create_array(
            name,
            shape=self.plan.shape,
            chunks=self.plan.chunks,
            dtype=dtype,
            fill_value=fill,
            dimension_names=self.plan.dims,
            attributes=attributes,
        )

    def _done(self) -> NumpyArray:
        """Return a bool array of which batches are stored."""
        flown = self._group[FLOWN]
        found = np.zeros(self.plan.batches, bool)
        # One file for each batch that is done: only these are read.
        folder = self.path / FLOWN / "c"
        for index in range(self.plan.batches) if folder.exists() else ():
            corner = np.unravel_index(index, self.plan.grid)
            if folder.joinpath(*map(str, map(int, corner))).exists():
                found[index] = bool(np.all(flown[self.plan.region(index)]))
        return found

    def write(self, batch: Batch, results: Mapping[str, NumpyArray]) -> None:
        """Write the results of a batch of W episodes, name -> array (W, ...).

        Raises:
            RunError: they cannot be written; what was kept before stays.
        """
        try:
            for name in self.metrics:
                self._group[name][batch.region] = results[name].reshape(batch.shape)
            if self.plan.track:
                self._group[TRACK][batch.region] = results[TRACK].reshape(*batch.shape, *self.plan.track)
            self._group[FLOWN][batch.region] = np.ones(batch.shape, bool)
        except OSError as error:
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            raise RunError(
                f"{self.path}: batch {batch.index + 1} of {self.plan.batches} cannot be written: "
                f"{error.strerror or error}; the {int(self.done.sum())} batches written before are kept"
                f"{', make room' if full else ''}, and the same command goes on from there"
            ) from None
        self.done[batch.index] = True

    def bytes_per_episode(self) -> float:
        """Return the store's size [bytes] per stored episode."""
        total = sum(file.stat().st_size for file in self.path.rglob("*") if file.is_file())
        episodes = sum(
            math.prod(part.stop - part.start for part in self.plan.region(int(i))) for i in np.flatnonzero(self.done)
        )
        return total / max(1, episodes)


def _metrics(plan: Plan) -> tuple[str, ...]:
    """Return the names of the metrics to store, with the one that defines a failure."""
    spec = plan.study.spec
    return tuple(dict.fromkeys([*spec.metrics, spec.failure.metric]))


def _without(about: Mapping[str, object], name: str) -> Content:
    """Return a copy of a mapping without the key ``name``."""
    return {key: value for key, value in about.items() if key != name}


def _about(axis: Axis) -> Content:
    """Return the attributes that describe an axis in the store."""
    return {"path": axis.path, **({"units": axis.unit} if axis.unit else {})}


def _coordinate(group: Any, name: str, dimension: str, values: NumpyArray, attributes: Content) -> None:
    """Write a coordinate of a dimension to the Zarr group; an array of objects is written as strings."""
    if values.dtype == object:
        array = group.create_array(
            name, shape=values.shape, dtype=str, dimension_names=(dimension,), attributes=attributes
        )
        array[:] = values
        return
    group.create_array(name, data=values, dimension_names=(dimension,), attributes=attributes)


def _attributes(plan: Plan) -> Content:
    """Return the attributes that describe the study in the store, without a date, so that equal studies are equal."""
    study = plan.study
    return {
        "kind": KIND,
        "name": study.spec.name,
        "description": study.spec.description,
        "digest": study.digest,
        "study": study.spec.model_dump_json(exclude={"scenario"}),
        "settings": json.dumps(study.settings, default=str),
        "source": study.source or "",
        "scenario": dump_yaml(study.content),
        "versions": versions(),
    }


def _refuse_other(path: Path, plan: Plan) -> None:
    """Raise UsageError if a folder is not a store of this study, or was begun with other versions."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            there = dict(zarr.open_group(path, mode="r").attrs)
    except (FileNotFoundError, ValueError, KeyError, NotADirectoryError):
        there = {}
    if there.get("kind") != KIND:
        raise UsageError(f"{path}: it exists and is no store of a sweep; choose another --out")
    study = plan.study
    if there["digest"] != study.digest:
        settings: Content = json.loads(str(there["settings"]))
        mine = json.loads(json.dumps(study.settings, default=str))
        different = list(_differing(mine, settings))
        more = len(different) - MOST_DIFFERENCES
        raise UsageError(
            f"{path}: this is a store of another study, '{there['name']}', not of '{study.spec.name}' as it is now; "
            "choose another --out",
            *(f"  {line}" for line in different[:MOST_DIFFERENCES]),
            *([f"  ... and {more} more"] if more > 0 else []),
        )
    other = differences(versions(), there["versions"])  # type: ignore[arg-type]
    if other:
        raise UsageError(
            f"{path}: it was begun with other versions, and its results would not go together; choose another --out",
            *(f"  {line}" for line in other),
        )


def _differing(mine: object, theirs: object, path: str = "") -> Iterator[str]:
    """Yield a line of text for each setting that differs between two studies, with both values."""
    if isinstance(mine, dict) and isinstance(theirs, dict):
        for key in {**mine, **theirs}:
            yield from _differing(mine.get(key), theirs.get(key), f"{path}.{key}".lstrip("."))
    elif mine != theirs:
        yield f"{path}: {_short(mine)} here, {_short(theirs)} in the store"


def _short(value: object) -> str:
    """Return a value as JSON text, shortened to 60 characters."""
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _tidy(path: Path) -> None:
    """Delete the partial files that a killed process left in a store."""
    for left in path.rglob("*.partial"):
        left.unlink(missing_ok=True)
