"""Readings and truth of a state as plain NumPy arrays, vehicles first."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import Any, cast

import jax
import numpy as np
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.tables import Table, Tabled, cells_of, columns_of, number_text
from qrsim.core.tree import Record, field_info, map_tree
from qrsim.errors import UsageError, did_you_mean
from qrsim.interface.arrays import as_array, library_of, quaternion_of
from qrsim.interface.estimates import EstimateReading, estimate_of, std_of
from qrsim.interface.messages import user_key, user_normals
from qrsim.interface.sources import FleetSource, whole
from qrsim.models.gnss.fixes import OF_SATELLITES, GnssFix
from qrsim.models.gnss.receivers import FEWEST_SATELLITES, GnssReading
from qrsim.models.radio.contracts import Inbox
from qrsim.models.sensors.attitude import AttitudeReading
from qrsim.models.sensors.camera import CameraReading
from qrsim.models.sensors.contracts import Explained
from qrsim.models.site import Site
from qrsim.world.radio import heard
from qrsim.world.state import Fleet, State, World

# Fields that a sensor has if it is asked for them, with the parameter that asks.
_UNASKED = {**dict.fromkeys(OF_SATELLITES, "per_satellite"), "velocity": "velocity"}


class SensorReading(Tabled):
    """The last reading of one sensor of n vehicles; its fields are attributes, see ``fields``.

    Where a reading is NaN, ``reasons`` says why. ``time_of_reading`` is when it was true, and ``tick_of_reading`` the
    same in ticks; ``fresh`` is whether it has arrived just now.

    Beside what the sensor's model gives, a GNSS reading has ``latitude_deg``, ``longitude_deg``, ``height`` [m above
    the ellipsoid] (float64, each (n,)) and ``fix_type`` (3: three-dimensional, 0: none), and one of a sensor ``gnss``
    the ``time_of_fix`` [s], when it was true. An attitude reading has ``quaternion`` (n, 4), w first, and a camera has
    its last picture: ``ratio`` (n, R, C), ``corners_ned`` (n, R + 1, C + 1, 2) and ``grid`` (n, 2), the rows and
    columns that the picture has; beyond them it is NaN.
    """

    def __init__(self, name: str, reading: Record | None, site: Site, source: FleetSource | None = None):
        """Use ``reading.NAME``; the record is that of the source where it is None."""
        self._name, self._given, self._site, self._source = name, reading, site, source
        self._rows = slice(None) if source is None else source.rows
        self._offsets = {} if source is None else source.offsets(name)

    @property
    def _reading(self) -> Record:
        if self._given is None:
            assert self._source is not None
            self._given = self._source.record(self._name)
        return self._given

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the sensor's fields."""
        said = vars(self._reading)
        own = tuple(
            field.name for field in dataclasses.fields(self._reading)
            if field.name not in _UNASKED or jax.tree.leaves(said[field.name])
        )  # fmt: skip
        if isinstance(self._reading, GnssReading):
            more = ["latitude_deg", "longitude_deg", "height", "fix_type"]
            if isinstance(self._reading, GnssFix) and self._timed:
                more.append("time_of_fix")
            return (*own, *(name for name in more if name not in own))
        if isinstance(self._reading, CameraReading):
            return (*own, *PICTURE_FIELDS)
        return (*own, "quaternion") if isinstance(self._reading, AttitudeReading) else own

    @property
    def time_of_reading(self) -> Floats:
        """Time (n,) [s] at which what is reported was true; that of the start until a first delayed reading arrives.

        It is in double precision, but for compiled programs in single precision, where a day has steps of 8 ms.
        """
        return self.tick_of_reading * (0.0 if self._source is None else self._source.time_step)

    @property
    def tick_of_reading(self) -> Floats:
        """Tick (n,), a whole number, at which what is reported was true; exact in compiled programs too."""
        return self._for_each(FleetSource.taken)

    @property
    def fresh(self) -> Floats:
        """(n,) bool: the reading has arrived at this very tick, and is not held since an earlier one."""
        return self._for_each(FleetSource.arrived)

    @property
    def _timed(self) -> bool:
        """Whether the times of its readings are known."""
        return self._source is not None and self._source.time_step > 0.0

    def _for_each(self, told: Callable[[FleetSource, str], Any]) -> Floats:
        if self._source is None or not self._timed:
            raise UsageError(f"{self._name}: the time of its readings is not available here")
        leaf = jax.tree.leaves(self._reading)[0]
        library: Any = library_of(leaf)
        return cast(Floats, library.broadcast_to(told(self._source, self._name), leaf.shape)[self._rows])

    @property
    def reasons(self) -> list[str]:
        """Reasons why vehicles (n,) have no complete reading, "" for those that have one."""
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(self._reading)]
        complete = np.all([np.isfinite(leaf) for leaf in leaves], axis=0)
        withheld = [""] * len(complete) if self._source is None else self._source.withheld(self._name)
        return [
            "" if whole else why or self._own_reason(i)
            for i, (whole, why) in enumerate(zip(complete, withheld, strict=True))
        ][self._rows]

    def _own_reason(self, vehicle: int) -> str:
        """Return why the sensor itself has nothing to say about a vehicle."""
        if not isinstance(self._reading, GnssReading):
            return self._reading.reason(vehicle) if isinstance(self._reading, Explained) else "not available"
        satellites = self._reading.satellites
        if satellites[vehicle] < FEWEST_SATELLITES:
            seen = ""
            if isinstance(self._reading, GnssFix):
                seen = f" used of {self._reading.satellites_seen[vehicle]:.0f} above the mask"
                counts = {
                    "behind obstacles": self._reading.satellites_blocked,
                    "jammed": self._reading.satellites_jammed,
                }
                parts = [f"{n[vehicle]:.0f} {why}" for why, n in counts.items() if n is not None and n[vehicle] > 0]
                seen += f" ({', '.join(parts)})" if parts else ""
            return f"no fix: {satellites[vehicle]:.0f} satellites{seen}, at least {FEWEST_SATELLITES} needed"
        known = np.isfinite(as_array(self._reading.position_ned)[vehicle]).all()
        return "no velocity: the fix before is missing" if known else "not available"

    def __getattr__(self, field: str) -> Floats:
        if field.startswith("_"):
            raise AttributeError(field)
        offsets = self._offsets.get(field)
        if offsets is not None and self._source is not None:
            return self._source.state.at(offsets)[self._rows]  # type: ignore[attr-defined]
        if field not in self.fields:
            if field in _UNASKED and field in vars(self._reading):
                raise AttributeError(f"sensor '{self._name}' has no '{field}'; give it {_UNASKED[field]}: true")
            raise AttributeError(f"sensor '{self._name}' has no '{field}'{did_you_mean(field, self.fields)}")
        if field == "time_of_fix":
            return self.time_of_reading
        if field in vars(self._reading):
            value = getattr(self._reading, field)
            # What a receiver has nothing to say about, as the age of corrections that it does not take.
            found = as_array(jax.tree.leaves(self._reading)[0] * 0.0 + 0.0 if value is None else value)
        else:
            found = self._derived(field)
        return found[self._rows]

    def _derived(self, field: str) -> Floats:
        if field == "quaternion":
            return quaternion_of(as_array(cast(AttitudeReading, self._reading).attitude))
        if field in PICTURE_FIELDS:
            return self._of_picture(field)
        position = as_array(cast(GnssReading, self._reading).position_ned)
        if field == "fix_type":
            lib = library_of(position)
            return lib.where(lib.isfinite(position).all(axis=1), 3, 0)
        if isinstance(position, jax.core.Tracer):
            raise UsageError(f"{self._name}.{field}: not available in a compiled function; use position_ned")
        latitude, longitude, height = self._site.ned_to_geodetic(position)
        return {"latitude_deg": np.degrees(latitude), "longitude_deg": np.degrees(longitude), "height": height}[field]

    def _of_picture(self, field: str) -> Floats:
        if self._source is None or not self._source.pictured:
            raise UsageError(
                f"{self._name}.{field}: not available here; a policy needs jax.jit, or init and step, for it"
            )
        seen = self._source.picture(self._name)
        lib = library_of(seen.ratio)
        if field == "ratio":
            return seen.ratio  # type: ignore[return-value]
        parts = (seen.north, seen.east) if field == "corners_ned" else (seen.rows, seen.columns)
        return lib.stack(parts, axis=-1)

    def __dir__(self) -> list[str]:
        """Return the fields too, for completion."""
        return [*super().__dir__(), *self.fields]

    @property
    def _traced(self) -> bool:
        """Whether it is a fix in a program that is being compiled, where there is no position on the ellipsoid."""
        reading = self._reading
        return isinstance(reading, GnssReading) and isinstance(reading.position_ned.x, jax.core.Tracer)

    def _units(self) -> dict[str, str]:
        """Return the unit of each field."""
        own = {field.name: field_info(field).unit for field in dataclasses.fields(self._reading)}
        return {name: own.get(name) or _UNITS.get(name, "") for name in self.fields}

    def _cells(self, columns: int) -> list[tuple[str, ...]]:
        """Return a row for each field: name, unit, and the numbers of each vehicle."""
        rows = []
        for name, unit in self._units().items():
            if name in PICTURE_FIELDS:
                cells: tuple[str, ...] = ("made when asked for", *[""] * (columns - 1))
            elif name in _GEODETIC and self._traced:
                continue
            else:
                cells = cells_of(getattr(self, name), columns, 9 if unit == "deg" else 4)
            rows.append((name, unit, *cells))
        return rows

    def _table(self) -> Table:
        names = range(jax.tree.leaves(self._reading)[0].shape[0]) if self._source is None else self._source.names
        columns = columns_of(list(map(str, names)))
        rows = self._cells(len(columns))
        if self._timed:
            rows.append(("time_of_reading", "s", *cells_of(self.time_of_reading, len(columns))))
        return Table(f"reading of {self._name}", ("field", "unit", *columns), rows)


class FleetReading(Tabled):
    """The last reading of every sensor of one fleet; its sensors are attributes, see ``sensors``."""

    def __init__(self, source: FleetSource):
        self._source = source

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors."""
        return self._source.fleet.sensor_names

    @property
    def estimate(self) -> EstimateReading:
        """Estimate of the fleet's own estimator now; without one, what its controller was fed with last."""
        return estimate_of(self._source.now, self._source.rows)

    @property
    def estimate_std(self) -> EstimateReading | None:
        """Standard deviations that the estimator reports, None where it reports none."""
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
        """Return a row for each field of each sensor, and of the estimate."""
        rows = [
            (f"{sensor}.{row[0]}", *row[1:])
            for sensor in self.sensors
            for row in self.__getattr__(sensor)._cells(columns)
        ]
        for name, believed in (("estimate", self.estimate), ("estimate_std", self.estimate_std)):
            rows += [] if believed is None else [(f"{name}.{row[0]}", *row[1:]) for row in believed._cells(columns)]
        return rows

    def _table(self) -> Table:
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
        """The whole state, the truth included; policies under evaluation must not use it."""
        return whole(self._state)

    @cached_property
    def _fleets(self) -> dict[str, FleetReading]:
        # Not before somebody asks: not every step of a loop is looked at.
        chosen = self._only and self.fleets
        found = {}
        for i, fleet in enumerate(self._world.fleets):
            if chosen is None or fleet.name in chosen:
                source = FleetSource(self._world, i, self._state, self.tick, self._site, self._rows(fleet))
                found[fleet.name] = FleetReading(source)
        return found

    @property
    def inbox(self) -> Inbox:
        """What each vehicle (n,) has heard over the radio, the newest message of each of K senders.

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
        """(2,) uint32: a key for random numbers of your own, another one at every tick and in every world.

        ``jax.random`` and ``numpy.random.default_rng`` take it; ``normals`` is for programs of qrsim's own compiler.
        """
        return cast(Floats, user_key(self._state, self.tick))

    def normals(self, count: int) -> Floats:
        """Return ``count`` standard normals for each vehicle, (n, count), others at every tick and in every world."""
        drawn = user_normals(self._world, self._state, self.tick, count)
        return cast(Floats, drawn[self._all_rows()])

    def _all_rows(self) -> slice:
        """Return which of all vehicles it is about."""
        begin = 0
        for fleet in self._world.fleets:
            if fleet.name in self.fleets and self._only is not None:
                rows = range(begin, begin + fleet.size)[self._rows(fleet)]
                return slice(rows.start, rows.stop)
            begin += fleet.size
        return slice(0, begin)

    def _rows(self, fleet: Fleet) -> slice:
        """Return which vehicles of a fleet it is about."""
        if self._only is None or self._only == fleet.name:
            return slice(None)
        row = fleet.vehicle_names.index(self._only)
        return slice(row, row + 1)

    @property
    def fleets(self) -> tuple[str, ...]:
        """Names of the fleets."""
        every = tuple(fleet.name for fleet in self._world.fleets)
        if self._only is None or self._only in every:
            return every if self._only is None else (self._only,)
        return tuple(fleet.name for fleet in self._world.fleets if self._only in fleet.vehicle_names)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all that it is about: of the fleets, and of their vehicles."""
        if self._only is not None and self._only not in self.fleets:
            return (self._only,)
        own = [fleet for fleet in self._world.fleets if fleet.name in self.fleets]
        return (*self.fleets, *(name for fleet in own for name in fleet.vehicle_names))

    def of(self, name: str) -> Reading:
        """Return the readings of one fleet or of one vehicle alone, whose arrays are then (1, ...).

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
        """Return what a single fleet has too, for completion."""
        alone = dir(self[self.fleets[0]]) if len(self.fleets) == 1 else ()
        return [*super().__dir__(), *alone]

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.fleets)

    def _table(self) -> Table:
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


# What a camera's picture has beside where and when it was taken.
PICTURE_FIELDS = ("ratio", "corners_ned", "grid")
# What readings add to fixes, by the ellipsoid, outside of compiled functions.
_GEODETIC = ("latitude_deg", "longitude_deg", "height")
# Of fields that no model declares.
_UNITS = {
    "latitude_deg": "deg", "longitude_deg": "deg", "height": "m", "fix_type": "1", "time_of_fix": "s",
    "quaternion": "1", "ratio": "1", "corners_ned": "m", "grid": "1",
}  # fmt: skip
