"""What a user sees of a state: readings and truth as plain NumPy arrays, vehicles first."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.errors import UsageError, did_you_mean
from qrsim.models.area import reason_text
from qrsim.models.attitude import AttitudeReading
from qrsim.models.gnss import FEWEST_SATELLITES, GnssReading
from qrsim.models.site import Site
from qrsim.world import Fleet, FleetState, State, World

Floats = np.ndarray[Any, Any]


def as_array(value: Any) -> Any:
    """Return a Vec3 or Euler as (n, 3), anything else as it is."""
    if isinstance(value, Vec3):
        return np.stack((value.x, value.y, value.z), axis=-1)
    if isinstance(value, Euler):
        return np.stack((value.roll, value.pitch, value.yaw), axis=-1)
    return value


def quaternion_of(attitude: Floats) -> Floats:
    """Return unit quaternions (n, 4), w first and w >= 0, of Euler angles (n, 3) [rad]: body to NED, ZYX."""
    half = 0.5 * np.asarray(attitude, np.float64)
    (cr, cp, cy), (sr, sp, sy) = np.cos(half).T, np.sin(half).T
    quaternion = np.stack(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        axis=-1,
    )
    return np.where(quaternion[:, :1] < 0.0, -quaternion, quaternion)


class SensorReading:
    """The last reading of one sensor of n vehicles; its fields are attributes, see ``fields``.

    Where a reading is NaN, ``reasons`` says why.

    Beside what the sensor's model gives, a GNSS reading has ``latitude_deg``, ``longitude_deg``, ``height`` [m above
    the ellipsoid] (float64, each (n,)) and ``fix_type`` (3: three-dimensional, 0: none), and an attitude reading has
    ``quaternion`` (n, 4), w first.
    """

    def __init__(self, name: str, reading: Any, site: Site, withheld: Sequence[str] = ()):
        self._name = name
        self._reading = reading
        self._site = site
        self._withheld = withheld

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of what the sensor reports."""
        own = tuple(field.name for field in dataclasses.fields(self._reading))
        if isinstance(self._reading, GnssReading):
            return (*own, "latitude_deg", "longitude_deg", "height", "fix_type")
        return (*own, "quaternion") if isinstance(self._reading, AttitudeReading) else own

    @property
    def reasons(self) -> list[str]:
        """Why each of the n vehicles has no complete reading, "" where it has one."""
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(self._reading)]
        complete = np.all([np.isfinite(leaf) for leaf in leaves], axis=0)
        withheld = self._withheld or [""] * len(complete)
        return [
            "" if whole else why or self._own_reason(i)
            for i, (whole, why) in enumerate(zip(complete, withheld, strict=True))
        ]

    def _own_reason(self, vehicle: int) -> str:
        """Return why the sensor itself has nothing to say about a vehicle."""
        satellites = getattr(self._reading, "satellites", None)
        if satellites is not None and satellites[vehicle] < FEWEST_SATELLITES:
            return f"no fix: {satellites[vehicle]:.0f} satellites, at least {FEWEST_SATELLITES} needed"
        return "not available"

    def __getattr__(self, field: str) -> Floats:
        if field.startswith("__"):
            raise AttributeError(field)
        if field not in self.fields:
            raise AttributeError(f"sensor '{self._name}' has no '{field}'{did_you_mean(field, self.fields)}")
        if hasattr(self._reading, field):
            return as_array(getattr(self._reading, field))
        return self._derived(field)

    def _derived(self, field: str) -> Floats:
        if field == "quaternion":
            return quaternion_of(as_array(self._reading.attitude))
        position = as_array(self._reading.position_ned)
        if field == "fix_type":
            return np.where(np.isfinite(position).all(axis=1), 3, 0)
        latitude, longitude, height = self._site.ned_to_geodetic(position)
        return {"latitude_deg": np.degrees(latitude), "longitude_deg": np.degrees(longitude), "height": height}[field]

    def __repr__(self) -> str:
        return f"<reading of {self._name}: {', '.join(self.fields)}>"


class FleetReading:
    """The last reading of every sensor of one fleet; its sensors are attributes, see ``sensors``."""

    def __init__(self, fleet: Fleet, state: FleetState, tick: int, site: Site):
        self._sensors = dict(zip(fleet.sensor_names, state.readings, strict=True))
        self._fleet, self._violation, self._tick, self._site = fleet, state.violation, tick, site

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors."""
        return tuple(self._sensors)

    def __getattr__(self, sensor: str) -> SensorReading:
        if sensor.startswith("__"):
            raise AttributeError(sensor)
        if sensor not in self._sensors:
            raise AttributeError(f"no sensor is called '{sensor}'{did_you_mean(sensor, self._sensors)}")
        return SensorReading(sensor, self._sensors[sensor], self._site, self._withheld(sensor))

    def _withheld(self, sensor: str) -> list[str]:
        """Return why nothing of a sensor reaches the user, for each vehicle; "" where its readings do."""
        stopped = [
            f"stopped, {reason_text(int(code), float(value))}" if code else ""
            for code, value in zip(self._violation.code, self._violation.value, strict=True)
        ]
        lost = np.zeros(len(stopped), bool)
        for fault in self._fleet.faults:
            if fault.sensor == sensor and fault.kind == "lost":
                lost |= np.asarray(fault.active(self._tick))  # type: ignore[arg-type]
        return [
            why or ("lost, by a fault of the scenario" if gone else "") for why, gone in zip(stopped, lost, strict=True)
        ]

    def __repr__(self) -> str:
        return f"<readings of {', '.join(self.sensors)}>"


class Reading:
    """What the sensors of all fleets say at one time; NaN for vehicles that are no longer valid.

    ``reading["pelicans"].gnss.position_ned`` is (n, 3). With a single fleet its name can be left out:
    ``reading.gnss.position_ned``.

    Attributes:
        time: simulated time [s].
    """

    def __init__(self, world: World, state: State, tick: int, site: Site):
        self.time = tick * world.time_step
        self._fleets = {
            fleet.name: FleetReading(fleet, fleet_state, tick, site)
            for fleet, fleet_state in zip(world.fleets, state.fleets, strict=True)
        }

    @property
    def fleets(self) -> tuple[str, ...]:
        """Names of the fleets."""
        return tuple(self._fleets)

    def __getitem__(self, fleet: str) -> FleetReading:
        if fleet not in self._fleets:
            raise UsageError(f"no fleet is called '{fleet}'{did_you_mean(str(fleet), self._fleets)}")
        return self._fleets[fleet]

    def __getattr__(self, sensor: str) -> SensorReading:
        if sensor.startswith("__"):
            raise AttributeError(sensor)
        if len(self._fleets) != 1:
            raise AttributeError(
                f"'{sensor}': there are several fleets; name one, reading['{self.fleets[0]}'].{sensor}"
            )
        return getattr(next(iter(self._fleets.values())), sensor)

    def __repr__(self) -> str:
        return f"<reading at {self.time:.3f} s: {', '.join(f'{k}: {v!r}' for k, v in self._fleets.items())}>"


class Truth:
    """The true state of all n vehicles, fleets one after the other."""

    def __init__(self, state: State):
        self._fleets = state.fleets

    def _gather(self, pick: Any) -> Floats:
        return np.concatenate([as_array(pick(fleet)) for fleet in self._fleets])

    @property
    def position_ned(self) -> Floats:
        """(n, 3) position [m]."""
        return self._gather(lambda fleet: fleet.vehicle.position_ned)

    @property
    def attitude(self) -> Floats:
        """(n, 3) roll, pitch, yaw [rad]."""
        return self._gather(lambda fleet: fleet.vehicle.attitude)

    @property
    def velocity_body(self) -> Floats:
        """(n, 3) velocity over ground in body axes [m/s]."""
        return self._gather(lambda fleet: fleet.vehicle.velocity_body)

    @property
    def velocity_ned(self) -> Floats:
        """(n, 3) velocity over ground [m/s]."""
        # JAX would silently compute in single precision otherwise.
        with jax.enable_x64(True):
            return np.asarray(
                self._gather(lambda fleet: rotation(fleet.vehicle.attitude).to_ned(fleet.vehicle.velocity_body))
            )

    @property
    def rates_body(self) -> Floats:
        """(n, 3) body rates [rad/s]."""
        return self._gather(lambda fleet: fleet.vehicle.rates_body)

    @property
    def thrust(self) -> Floats:
        """(n,) collective thrust [N]."""
        return self._gather(lambda fleet: fleet.vehicle.thrust)

    @property
    def specific_force(self) -> Floats:
        """(n, 3) mean specific force of the last step in body axes [m/s^2]."""
        return self._gather(lambda fleet: fleet.specific_force)

    @property
    def wind_ned(self) -> Floats:
        """(n, 3) air velocity at the vehicle during the last step [m/s], gusts included."""
        return self._gather(lambda fleet: fleet.mean_wind_ned + fleet.gust_ned)

    @property
    def command(self) -> Floats:
        """(n, 5) the last command as flown: pitch, roll, throttle, yaw rate, battery."""
        return self._gather(lambda f: np.stack(list(vars(f.command).values()), axis=-1))

    @property
    def state(self) -> Floats:
        """(n, 13) position, Euler angles, body velocity, body rates, thrust."""
        parts = (self.position_ned, self.attitude, self.velocity_body, self.rates_body, self.thrust[:, None])
        return np.concatenate(parts, axis=1)
