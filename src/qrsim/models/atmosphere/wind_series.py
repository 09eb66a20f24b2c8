"""Mean wind from a recorded series, and a steady wind that turns with height."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.core.fastmath import exp, log
from qrsim.core.series import interval_at, split_seconds
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.files.time_series import check_covers, read_series
from qrsim.models.atmosphere.contracts import Wind
from qrsim.models.atmosphere.wind import FEET_PER_METRE, REFERENCE_FT, ROUGHNESS_FT, wind_to_ned


@record
class WindSeries(Wind):
    """The air's velocity at K increasing times, linear in between; ``WindFile.at`` makes it.

    Times are whole seconds plus a fraction, because a float32 of a day's seconds would be 8 ms off.
    """

    seconds: Array = quantity(unit="s", doc="(K,) int32, whole seconds since the start of the run")
    fraction: Array = quantity(unit="s", doc="(K,) the rest, in [0, 1)")
    air_ned: Vec3 = quantity(unit="m/s", doc="(K,) velocity of the air in NED")
    mean_ned: Vec3 = quantity(default=None, unit="m/s", doc="() mean over the whole series")

    def mean_velocity_ned(self, height_agl: Array) -> Vec3:
        """Return the wind velocity (n,) [m/s] NED averaged over the series, the same at all heights (n,)."""
        return self.mean_ned.map(lambda axis: jnp.broadcast_to(jnp.asarray(axis), height_agl.shape))

    def largest_speed(self, height: NumpyArray) -> NumpyArray:
        """Return the largest horizontal wind speed [m/s] at any time, for heights of any shape."""
        return np.full(np.shape(height), np.hypot(np.asarray(self.air_ned.x), np.asarray(self.air_ned.y)).max())

    def velocity_ned(self, height_agl: Array, seconds: Array, fraction: Array) -> Vec3:
        """Return the wind velocity (n,) [m/s] NED at a time, the same at all heights (n,); ends extend unchanged.

        Args:
            height_agl: (n,) [m].
            seconds, fraction: () int32 and float, time since the start of the run [s].
        """
        rows, parts = jnp.asarray(self.seconds), jnp.asarray(self.fraction)
        before, since, interval = interval_at(rows, parts, seconds, fraction)
        share = jnp.clip(since / interval, 0.0, 1.0)

        def at(axis: Array) -> Array:
            """Return one wind component (n,), interpolated between two times of the series."""
            axis = jnp.asarray(axis)
            return jnp.broadcast_to(axis[before] + share * (axis[before + 1] - axis[before]), height_agl.shape)

        return self.air_ned.map(at)


@record
class WindFile:
    """A wind read from a CSV file with the columns time [s], north, east and down [m/s], or speed and wind_from [deg].

    The file must cover the scenario's duration. A simulation that is stepped on beyond the last row keeps that row's
    wind.
    """

    file: str = setting(doc="CSV file with a header; time 0 is the start of the run, velocities are the air's")
    max_gap: float = setting(
        default=10.0, unit="s", doc="longest interval between two rows that is interpolated", above=0.0
    )

    def at(self, duration: float) -> WindSeries:
        """Return the wind series for a run of ``duration`` [s], read from the file, in float64.

        Args:
            duration: length of the run [s], which the series must cover from 0 on.

        Raises:
            UsageError: the file is missing, is no such table, has a gap, or does not cover the run.
        """
        times, air = read_wind(Path(self.file), self.max_gap)
        check_covers(f"{self.file}: the series", times, duration)
        columns: Any = (np.ascontiguousarray(air[:, axis]) for axis in range(3))
        means = np.trapezoid(air, times, axis=0) / (times[-1] - times[0])
        return WindSeries(*split_seconds(times), Vec3(*columns), Vec3(*means))


def read_wind(path: Path, max_gap: float) -> tuple[NumpyArray, NumpyArray]:
    """Return times (K,) [s] and wind velocities (K, 3) [m/s] NED from a CSV file, K at least 2.

    Its columns are ``north``, ``east`` and, if the air rises or sinks, ``down`` [m/s]; or those of an anemometer,
    ``speed`` [m/s] and ``wind_from`` [deg], the bearing the wind comes from, clockwise from north.

    Args:
        path: the file.
        max_gap: longest interval allowed between two rows [s].

    Raises:
        UsageError: as ``read_series``, or a speed is below 0.
    """
    times, columns = read_series(
        path,
        {"north": "m/s", "east": "m/s"},
        max_gap,
        optional={"down": "m/s"},
        instead={"speed": "m/s", "wind_from": "deg"},
    )
    if "speed" in columns:
        speed, bearing = columns["speed"], np.radians(columns["wind_from"])
        if np.any(speed < 0.0):
            raise UsageError(f"{path}: column 'speed': {speed.min():g} m/s; allowed: from 0")
        columns |= {"north": -speed * np.cos(bearing), "east": -speed * np.sin(bearing)}
    down = columns.get("down", np.zeros_like(times))
    return times, np.column_stack([columns["north"], columns["east"], down])


@record
class VeeringShear(Wind):
    """A steady wind; its speed follows a law of height, and its bearing turns evenly with height."""

    speed_20ft: Array = parameter(unit="m/s", doc="speed 20 ft (6.096 m) above the ground", minimum=0.0, maximum=50.0)
    wind_from_rad: Array = parameter(
        unit="rad",
        doc="bearing the wind comes from 20 ft above the ground, clockwise from north",
        minimum=-2 * math.pi,
        maximum=2 * math.pi,
    )
    veer_per_100m_rad: Array = parameter(
        default=0.0,
        unit="rad",
        doc="clockwise turn of the bearing per 100 m of height",
        minimum=-math.pi,
        maximum=math.pi,
    )
    exponent: Array = parameter(
        default=0.143, unit="1", doc="exponent of the power law; 1/7 over open country", minimum=0.0, maximum=1.0
    )
    profile: Literal["log", "power"] = setting(
        default="log", doc="speed with height: 'log' as log_shear, 'power' (h/20 ft)^exponent"
    )

    def velocity_ned(self, height_agl: Array, seconds: Array, fraction: Array) -> Vec3:
        """Return the wind velocity (n,) [m/s] NED at heights (n,) [m]: it turns with height and is constant in time.

        Logarithmic: u20 ln(h/z0)/ln(20/z0), h in feet, z0 = 0.15 ft, zero below z0 (MIL-F-8785C, section 3.7.3.2).
        Power law: u20 (h/20 ft)^exponent, zero at and below the ground.
        """
        feet = jnp.maximum(height_agl, 0.0) * FEET_PER_METRE
        if self.profile == "log":
            ratio = jnp.maximum(feet * (1.0 / ROUGHNESS_FT), 1.0)
            speed = self.speed_20ft * log(ratio) * (1.0 / math.log(REFERENCE_FT / ROUGHNESS_FT))
        else:
            speed = self.speed_20ft * exp(self.exponent * log(jnp.maximum(feet * (1.0 / REFERENCE_FT), 1e-30)))
            speed = jnp.where(feet > 0.0, speed, 0.0)
        zero = jnp.zeros_like(speed)
        turn = self.veer_per_100m_rad * ((feet - REFERENCE_FT) * (0.01 / FEET_PER_METRE))
        return wind_to_ned(speed, zero, zero, self.wind_from_rad + turn)
