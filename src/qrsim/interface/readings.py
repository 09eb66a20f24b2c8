"""Readings and truth of a state as plain NumPy arrays, vehicles first."""

from __future__ import annotations

from functools import cached_property
from typing import cast

import numpy as np
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.tables import Table, Tabled, columns_of, number_text
from qrsim.core.tree import map_tree
from qrsim.errors import UsageError, did_you_mean
from qrsim.interface.estimates import EstimateReading, estimate_of, std_of
from qrsim.interface.messages import user_key, user_normals
from qrsim.interface.sensor_reading import SensorReading
from qrsim.interface.sources import FleetSource, whole
from qrsim.models.radio.contracts import Inbox
from qrsim.models.site import Site
from qrsim.world.radio import heard
from qrsim.world.state import Fleet, State, World


class FleetReading(Tabled):
    """The last reading of every sensor of one fleet; its sensors are attributes, see ``sensors``."""

    def __init__(self, source: FleetSource):
        self._source = source

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the fleet's sensors, each an attribute of this object."""
        return self._source.fleet.sensor_names

    @property
    def estimate(self) -> EstimateReading:
        """Present estimate: of the fleet's own estimator, else the last that its controller used."""
        return estimate_of(self._source.now, self._source.rows)

    @property
    def estimate_std(self) -> EstimateReading | None:
        """Standard deviations that the fleet's estimator reports; None if it reports none."""
        return std_of(self._source.now, self._source.rows)

    def __getattr__(self, sensor: str) -> SensorReading:
        if sensor.startswith("__"):
            raise AttributeError(sensor)
        if sensor not in self._source.fleet.sensor_names:
            raise AttributeError(f"no sensor is called '{sensor}'{did_you_mean(sensor, self.sensors)}")
        return SensorReading(sensor, None, self._source.site, self._source)

    def __dir__(self) -> list[str]:
        """Return the sensors too, for completion."""
        return [*super().__dir__(), *self.sensors]

    def _cells(self, columns: int) -> list[tuple[str, ...]]:
        """Return a row of texts for each field of each sensor and of the estimate; ``columns``: number of vehicles
        shown."""
        rows = [
            (f"{sensor}.{row[0]}", *row[1:])
            for sensor in self.sensors
            for row in self.__getattr__(sensor)._cells(columns)
        ]
        for name, believed in (("estimate", self.estimate), ("estimate_std", self.estimate_std)):
            rows += [] if believed is None else [(f"{name}.{row[0]}", *row[1:]) for row in believed._cells(columns)]
        return rows

    def _table(self) -> Table:
        """Return the fleet's readings as a table for display: a row for each field, a column for each vehicle."""
        columns = columns_of(self._source.names)
        title = f"readings of fleet '{self._source.fleet.name}'"
        return Table(title, ("field", "unit", *columns), self._cells(len(columns)))


class Reading(Tabled):
    """Readings of the sensors of all fleets at one time; NaN for vehicles that are no longer valid.

    ``reading["pelicans"].gnss.position_ned`` is (n, 3), and ``reading["pelicans"].estimate.position_ned`` the estimate
    of the fleet's own estimator. With a single fleet its name can be left out: ``reading.gnss.position_ned``.

    Attributes:
        time: simulated time [s]; in compiled programs of single precision a day has steps of 8 ms.
        tick: number of time steps since the start, exact everywhere.
    """

    def __init__(self, world: World, state: State, tick: int, site: Site, only: str | None = None):
        # In a program that is being compiled in the precision of its numbers.
        self.time = (
            tick * world.time_step if isinstance(tick, int) else cast(float, tick.astype(float)) * world.time_step
        )
        self.tick = tick
        self._world, self._state, self._site, self._only = world, state, site, only

    @property
    def state(self) -> State:
        """Whole simulated state, the truth included; do not use it in a policy whose performance is measured."""
        return whole(self._state)

    @cached_property
    def _fleets(self) -> dict[str, FleetReading]:
        """Readings of each fleet by its name."""
        # Built on first use, because many steps of a loop read no sensor.
        chosen = self._only and self.fleets
        found = {}
        for i, fleet in enumerate(self._world.fleets):
            if chosen is None or fleet.name in chosen:
                source = FleetSource(self._world, i, self._state, self.tick, self._site, self._rows(fleet))
                found[fleet.name] = FleetReading(source)
        return found

    @property
    def inbox(self) -> Inbox:
        """Radio messages that each vehicle (n,) has received: the newest of each of K senders.

        See docs/howto/radio.md.

        Raises:
            UsageError: the scenario has no radio.
        """
        if self._world.radio is None:
            raise UsageError("inbox: the scenario has no world.radio")
        tick = cast(Array, np.int32(self.tick) if isinstance(self.tick, int) else self.tick)
        everybody = heard(self._world, self._state, tick)
        return map_tree(lambda leaf: leaf[self._all_rows()], everybody)

    @property
    def key(self) -> Floats:
        """JAX random key (2,) uint32 for users' functions, different at every tick and in every world.

        ``jax.random`` and ``numpy.random.default_rng`` take it; ``normals`` is for programs of qrsim's own compiler.
        """
        return cast(Floats, user_key(self._state, self.tick))

    def normals(self, count: int) -> Floats:
        """Return ``count`` standard normal numbers for each vehicle, (n, count), different at every tick and in every
        world."""
        drawn = user_normals(self._world, self._state, self.tick, count)
        return cast(Floats, drawn[self._all_rows()])

    def _all_rows(self) -> slice:
        """Return the rows, among all vehicles of the world, that this object covers."""
        begin = 0
        for fleet in self._world.fleets:
            if fleet.name in self.fleets and self._only is not None:
                rows = range(begin, begin + fleet.size)[self._rows(fleet)]
                return slice(rows.start, rows.stop)
            begin += fleet.size
        return slice(0, begin)

    def _rows(self, fleet: Fleet) -> slice:
        """Return the rows of a fleet that this object covers."""
        if self._only is None or self._only == fleet.name:
            return slice(None)
        row = fleet.vehicle_names.index(self._only)
        return slice(row, row + 1)

    @property
    def fleets(self) -> tuple[str, ...]:
        """Names of the fleets that this object covers, or of which it covers a vehicle."""
        every = tuple(fleet.name for fleet in self._world.fleets)
        if self._only is None or self._only in every:
            return every if self._only is None else (self._only,)
        return tuple(fleet.name for fleet in self._world.fleets if self._only in fleet.vehicle_names)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fleets that this object covers, and of their vehicles."""
        if self._only is not None and self._only not in self.fleets:
            return (self._only,)
        own = [fleet for fleet in self._world.fleets if fleet.name in self.fleets]
        return (*self.fleets, *(name for fleet in own for name in fleet.vehicle_names))

    def of(self, name: str) -> Reading:
        """Return the readings of one fleet, or of one vehicle with arrays (1, ...), by its name.

        Raises:
            UsageError: none is called so.
        """
        if name not in self.names:
            raise UsageError(f"no fleet and no vehicle is called '{name}'{did_you_mean(str(name), self.names)}")
        return Reading(self._world, self._state, self.tick, self._site, name)

    def __getitem__(self, fleet: str) -> FleetReading:
        if fleet not in self.fleets:
            if any(fleet == other.name for other in self._world.fleets):
                raise UsageError(f"the readings of '{fleet}' are not among those of '{self._only}'")
            raise UsageError(f"no fleet is called '{fleet}'{did_you_mean(str(fleet), self.fleets)}")
        return self._fleets[fleet]

    def __getattr__(self, sensor: str) -> SensorReading:
        if sensor.startswith("__"):
            raise AttributeError(sensor)
        if len(self._fleets) != 1:
            raise AttributeError(
                f"'{sensor}': there are several fleets; name one, reading['{self.fleets[0]}'].{sensor}"
            )
        return getattr(next(iter(self._fleets.values())), sensor)

    def __dir__(self) -> list[str]:
        """Return the attributes of a single fleet's reading too, for completion."""
        alone = dir(self[self.fleets[0]]) if len(self.fleets) == 1 else ()
        return [*super().__dir__(), *alone]

    def _ipython_key_completions_(self) -> list[str]:
        """Return the fleets' names, which IPython offers as keys."""
        return list(self.fleets)

    def _table(self) -> Table:
        """Return the readings of all fleets as a table for display: a row for each field, a column for each vehicle."""
        time = self._world.time_step * self.tick if isinstance(self.tick, int) else self.time
        title = f"reading at {number_text(time)} s"
        parts = [(name, part, columns_of(part._source.names)) for name, part in self._fleets.items()]
        width = max(len(columns) for _, _, columns in parts)
        if len(parts) == 1:
            _, part, columns = parts[0]
            return Table(title, ("field", "unit", *columns), part._cells(width))
        rows: list[tuple[str, ...]] = []
        for name, part, columns in parts:
            rows.append((f"fleet '{name}'", "", *columns, *[""] * (width - len(columns))))
            rows += [(*row, *[""] * (width - len(columns))) for row in part._cells(len(columns))]
        return Table(title, ("field", "unit", *[""] * width), rows)
