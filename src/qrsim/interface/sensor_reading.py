"""The last reading of one sensor as plain NumPy arrays, vehicles first."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, cast

import jax
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.tables import Table, Tabled, cells_of, columns_of
from qrsim.core.tree import Record, field_info
from qrsim.errors import UsageError, did_you_mean
from qrsim.interface.arrays import as_array, library_of, quaternion_of
from qrsim.interface.sources import FleetSource
from qrsim.models.gnss.fixes import OF_SATELLITES, GnssFix
from qrsim.models.gnss.receivers import FEWEST_SATELLITES, GnssReading
from qrsim.models.sensors.attitude import AttitudeReading
from qrsim.models.sensors.camera import CameraReading
from qrsim.models.sensors.contracts import Explained
from qrsim.models.site import Site

# Optional fields of readings, with the parameter that enables each.
_UNASKED = {**dict.fromkeys(OF_SATELLITES, "per_satellite"), "velocity": "velocity"}


class SensorReading(Tabled):
    """The last reading of one sensor of n vehicles; its fields are attributes, see ``fields``.

    Where a reading is NaN, ``reasons`` says why. ``time_of_reading`` is when it was true, and ``tick_of_reading`` the
    same in ticks; ``fresh`` is whether it has arrived just now.

    In addition to the fields of the sensor's model, a GNSS reading has ``latitude_deg``, ``longitude_deg``, ``height``
    [m above the ellipsoid] (float64, each (n,)) and ``fix_type`` (3: three-dimensional, 0: none), and one of a sensor
    ``gnss`` the ``time_of_fix`` [s], when it was true. An attitude reading has ``quaternion`` (n, 4), w first, and a
    camera has its last picture: ``ratio`` (n, R, C), ``corners_ned`` (n, R + 1, C + 1, 2) and ``grid`` (n, 2), the rows
    and columns that the picture has; beyond them it is NaN.
    """

    def __init__(self, name: str, reading: Record | None, site: Site, source: FleetSource | None = None):
        """Use ``reading.NAME``; the record is that of the source where it is None."""
        self._name, self._given, self._site, self._source = name, reading, site, source
        self._rows = slice(None) if source is None else source.rows
        self._offsets = {} if source is None else source.offsets(name)

    @property
    def _reading(self) -> Record:
        """Last delivered reading of the sensor, as a record."""
        if self._given is None:
            assert self._source is not None
            self._given = self._source.record(self._name)
        return self._given

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the fields of the sensor's reading."""
        said = vars(self._reading)
        own = tuple(
            field.name
            for field in dataclasses.fields(self._reading)
            if field.name not in _UNASKED or jax.tree.leaves(said[field.name])
        )
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
        """Time (n,) [s] at which the reading was taken; until the first delayed reading arrives, that of the start.

        It is in double precision, but for compiled programs in single precision, where a day has steps of 8 ms.
        """
        return self.tick_of_reading * (0.0 if self._source is None else self._source.time_step)

    @property
    def tick_of_reading(self) -> Floats:
        """Tick (n,) at which the reading was taken, a whole number, exact in compiled programs too."""
        return self._for_each(FleetSource.taken)

    @property
    def fresh(self) -> Floats:
        """Which vehicles, (n,) bool, receive the reading at this very tick; False while an earlier one is held."""
        return self._for_each(FleetSource.arrived)

    @property
    def _timed(self) -> bool:
        """True if the times at which the readings were taken are known."""
        return self._source is not None and self._source.time_step > 0.0

    def _for_each(self, time_of: Callable[[FleetSource, str], Any]) -> Floats:
        """Return ``time_of(source, sensor name)`` broadcast to (n,); raises UsageError if the readings' times are
        unknown."""
        if self._source is None or not self._timed:
            raise UsageError(f"{self._name}: the time of its readings is not available here")
        leaf = jax.tree.leaves(self._reading)[0]
        library = library_of(leaf)
        return cast(Floats, library.broadcast_to(time_of(self._source, self._name), leaf.shape)[self._rows])

    @property
    def reasons(self) -> list[str]:
        """Reasons why the vehicles (n,) lack a complete reading; "" for those that have one."""
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(self._reading)]
        complete = np.all([np.isfinite(leaf) for leaf in leaves], axis=0)
        withheld = [""] * len(complete) if self._source is None else self._source.withheld(self._name)
        return [
            "" if whole else why or self._own_reason(i)
            for i, (whole, why) in enumerate(zip(complete, withheld, strict=True))
        ][self._rows]

    def _own_reason(self, vehicle: int) -> str:
        """Return the sensor model's own reason for the incomplete reading of vehicle number ``vehicle``."""
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
        """Return a field that is computed from others: quaternion, fix type, latitude or picture."""
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
        """Return a field of the last picture that the camera took."""
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
        """True for a GNSS fix in a program that is being compiled, which has no geodetic position."""
        reading = self._reading
        return isinstance(reading, GnssReading) and isinstance(reading.position_ned.x, jax.core.Tracer)

    def _units(self) -> dict[str, str]:
        """Return the unit of each field of the reading."""
        own = {field.name: field_info(field).unit for field in dataclasses.fields(self._reading)}
        return {name: own.get(name) or _UNITS.get(name, "") for name in self.fields}

    def _cells(self, columns: int) -> list[tuple[str, ...]]:
        """Return a row of texts for each field of the reading: name, unit, and up to ``columns`` vehicles' numbers."""
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
        """Return the reading as a table for display: a row for each field, a column for each vehicle."""
        names = range(jax.tree.leaves(self._reading)[0].shape[0]) if self._source is None else self._source.names
        columns = columns_of(list(map(str, names)))
        rows = self._cells(len(columns))
        if self._timed:
            rows.append(("time_of_reading", "s", *cells_of(self.time_of_reading, len(columns))))
        return Table(f"reading of {self._name}", ("field", "unit", *columns), rows)


# Fields of a camera's picture, without the place and time at which it was taken.
PICTURE_FIELDS = ("ratio", "corners_ned", "grid")
# Fields on the ellipsoid that readings add to fixes, outside of compiled functions.
_GEODETIC = ("latitude_deg", "longitude_deg", "height")
# Of fields that no model declares.
_UNITS = {
    "latitude_deg": "deg",
    "longitude_deg": "deg",
    "height": "m",
    "fix_type": "1",
    "time_of_fix": "s",
    "quaternion": "1",
    "ratio": "1",
    "corners_ned": "m",
    "grid": "1",
}
