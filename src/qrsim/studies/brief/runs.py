"""The runs of a brief that are in its stores, as arrays over all of them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import RunError
from qrsim.files import Content
from qrsim.studies.sweep.results import Results


@dataclass(frozen=True)
class Moment:
    """The moment of a margin or a loss.

    Attributes:
        seed: of the run.
        vehicle: its name, "" where it is not known.
        leg: its number from 1, None where it is not known.
        at_s: time in the run [s], None where it is not known.
    """

    seed: int
    vehicle: str
    leg: int | None
    at_s: float | None

    def text(self) -> str:
        """Return the moment as text: vehicle, leg, time and seed."""
        parts = [self.vehicle and f"vehicle {self.vehicle}", "" if self.leg is None else f"leg {self.leg}"]
        parts += ["" if self.at_s is None else f"{self.at_s:.0f} s", f"seed {self.seed}"]
        return ", ".join(part for part in parts if part)


class Runs:
    """Runs of several stores, one after the other, in the order of their seeds.

    Args:
        stores: paths; those without any run are left out.
        names: of the vehicles.
    """

    def __init__(self, stores: Iterable[Path], names: tuple[str, ...]):
        self.names = names
        self._results = []
        for path in stores:
            try:
                self._results.append(Results(path))
            except RunError:  # nothing has been flown yet
                continue

    def __len__(self) -> int:
        return sum(results.episodes for results in self._results)

    def __getitem__(self, metric: str) -> NumpyArray:
        """Return a metric (E,) in double precision."""
        return np.concatenate([np.empty(0), *(results.metric(metric) for results in self._results)])

    @property
    def seeds(self) -> NumpyArray:
        """Seed (E,) of each of the E runs."""
        return np.concatenate([np.empty(0, np.int64), *(results.seeds for results in self._results)])

    def tracks(self, most: int) -> NumpyArray:
        """Return north, east, down [m] and charge (E, R, n, 4) of at most ``most`` runs; NaN after a run's end."""
        found: list[NumpyArray] = []
        for results in self._results:
            if (left := most - sum(map(len, found))) > 0:
                found.append(results.tracks[:left])
        return np.concatenate(found) if found else np.empty((0, 1, len(self.names), 4))

    def values_at(self, run: int) -> Content:
        """Return scenario path -> value of the parameters of run number ``run``, those of its start time included."""
        for results in self._results:
            if run < results.episodes:
                return {**results.spec.set, **results.values_at(run)}
            run -= results.episodes
        raise IndexError(run)

    def moment(self, run: int, margin: str) -> Moment:
        """Return the moment, with vehicle and leg, at which a run came closest to a ``margin`` such as the fence."""
        return self._moment(run, f"{margin}_vehicle", f"{margin}_leg", f"{margin}_at_s")

    def loss(self, run: int) -> Moment:
        """Return the moment, with vehicle and leg, at which the first vehicle of a run was lost."""
        return self._moment(run, "stopped_vehicle", "stopped_leg", "stopped_s")

    def _moment(self, run: int, *metrics: str) -> Moment:
        """Return the moment that three metrics of a run describe: vehicle, leg and time."""
        vehicle, leg, at = (float(self[metric][run]) for metric in metrics)
        name = "" if math.isnan(vehicle) else self.names[int(vehicle)] if int(vehicle) < len(self.names) else ""
        number = None if math.isnan(leg) else int(leg)
        return Moment(int(self.seeds[run]), name, number, None if math.isnan(at) else at)
