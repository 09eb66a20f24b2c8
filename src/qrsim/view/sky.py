"""The sky over a vehicle, as its receiver last said: what browsers draw of it (sky.js).

It is there for receivers with ``per_satellite: true``. A browser is told of the vehicle that it has chosen, and only
what is new.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.models.gnss.constellations import satellite_name
from qrsim.models.gnss.fixes import OF_SATELLITES, GnssFix
from qrsim.world.state import State

# Of a satellite: its name, azimuth and elevation [deg], C/N0 [dB-Hz], state.
Satellite = tuple[str, int, int, int, int]


def of_satellites(column: str) -> bool:
    """Return whether a logged quantity belongs to a single satellite slot, such as ``gnss.cn0.0``."""
    parts = column.split(".")
    return len(parts) > 2 and parts[-2] in OF_SATELLITES and parts[-1].isdigit()


def satellites(said: Mapping[str, Floats]) -> list[Satellite]:
    """Return the satellites above the horizon, from a receiver's reading: field -> values (K,) of its slots."""
    number, elevation = np.asarray(said["satellite"]), np.degrees(np.asarray(said["elevation"], np.float64))
    there = np.flatnonzero((number >= 0) & (elevation >= 0.0))
    azimuth = np.degrees(np.asarray(said["azimuth"], np.float64))
    return [
        (
            satellite_name(int(number[k])),
            round(float(azimuth[k])),
            round(float(elevation[k])),
            round(float(said["cn0"][k])),
            int(said["satellite_state"][k]),
        )
        for k in there.tolist()
    ]


def told(vehicle: str, found: list[Satellite]) -> dict[str, object] | None:
    """Return the message that tells a browser a vehicle's satellites, for JSON; None without satellites."""
    return {"vehicle": vehicle, "satellites": found} if found else None


def sky_of_state(state: State, fleet: int, vehicle: int) -> list[Satellite]:
    """Return the satellites that a vehicle's receiver reports in a state; [] if no receiver reports single ones."""
    for reading in state.fleets[fleet].readings:
        if isinstance(reading, GnssFix) and reading.cn0 is not None:
            said = {
                name: np.array([np.asarray(leaf)[vehicle] for leaf in getattr(reading, name)]) for name in OF_SATELLITES
            }
            return satellites(said) if np.isfinite(said["elevation"]).all() else []
    return []


def columns_of(names: Sequence[str]) -> list[dict[str, str]]:
    """Return field -> column name for each satellite slot of the first receiver that logs single satellites."""
    sensor = next((name.removesuffix(".cn0.0") for name in names if name.endswith(".cn0.0")), None)
    slots = sum(name.startswith(f"{sensor}.cn0.") for name in names)
    return [{field: f"{sensor}.{field}.{k}" for field in OF_SATELLITES} for k in range(slots)]
