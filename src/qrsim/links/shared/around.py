"""What vehicles perceive around them at a tick, for links that send it: scans, neighbours, and flow over the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.shared.sight import FLOW, Sight
from qrsim.models.sensors.neighbours import IdealNeighbours, NeighbourSensor
from qrsim.models.sensors.ranging import IdealRanging, Ranging
from qrsim.models.sensors.scan import IdealScan, Scan
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet

SCANS, RANGINGS, NEIGHBOURS = (Scan, IdealScan), (Ranging, IdealRanging), (NeighbourSensor, IdealNeighbours)


def first_of(fleet: Fleet, kinds: tuple[type, ...]) -> int | None:
    """Return the index of a fleet's first sensor that is an instance of one of ``kinds``; None without one."""
    return next((i for i, sensor in enumerate(fleet.sensors) if isinstance(sensor, kinds)), None)


@dataclass(frozen=True)
class Neighbours:
    """Other vehicles, as one sees them.

    Attributes:
        position: (K, 3) in the axes of the sensor, FRD [m].
        velocity: (K, 3) against the vehicle, in these axes [m/s]; NaN if it is not measured.
        vehicle: (K,) number in the world, -1 if it is not known.
    """

    position: NumpyArray
    velocity: NumpyArray
    vehicle: NumpyArray


class Around:
    """What the vehicles of a simulation perceive now; nothing is computed before it is asked for.

    Args:
        simulation: reset.
        sight: of it.
    """

    def __init__(self, simulation: Simulation, sight: Sight):
        self._simulation = simulation
        # Of each vehicle: its fleet, number there, numbers of its sensors, and the period of its optical flow [s].
        self._rows: list[tuple[Fleet, int, int | None, int | None, float]] = []
        for number, fleet in enumerate(simulation.world.fleets):
            scan, neighbours = first_of(fleet, SCANS), first_of(fleet, NEIGHBOURS)
            flow = sight.sensor(number, FLOW)
            period = 0.0 if flow is None else float(flow.period)
            self._rows += [(fleet, i, scan, neighbours, period) for i in range(fleet.size)]

    def _reading(self, fleet: Fleet, sensor: int) -> Any:
        """Return the present reading of a fleet's sensor, given by its index."""
        return getattr(self._simulation.reading[fleet.name], fleet.sensor_names[sensor])

    def scan(self, row: int) -> tuple[Any, int, NumpyArray] | None:
        """Return a vehicle's lidar, its number in the fleet, and its measured ranges (R,) [m], left to right; None
        without a lidar."""
        fleet, own, sensor, _, _ = self._rows[row]
        if sensor is None:
            return None
        return fleet.sensors[sensor], own, np.asarray(self._reading(fleet, sensor).range, np.float64)[own]

    def neighbours(self, row: int) -> Neighbours | None:
        """Return the neighbours that the vehicle at ``row`` senses, nearest first; None without such a sensor."""
        fleet, own, _, sensor, _ = self._rows[row]
        if sensor is None:
            return None
        reading = self._reading(fleet, sensor)
        position = np.asarray(reading.position, np.float64)[own]
        there = np.isfinite(position).all(axis=1)
        velocity = np.full_like(position, np.nan)
        looking: Any = fleet.sensors[sensor]
        if looking.velocity:
            velocity = np.asarray(reading.velocity, np.float64)[own]
        vehicle = np.nan_to_num(np.asarray(reading.vehicle, np.float64)[own], nan=-1.0).astype(int)
        return Neighbours(position[there], velocity[there], vehicle[there])

    def flow_period(self, row: int) -> float:
        """Return the interval [s] between the optical-flow readings of the vehicle at ``row``; 0 without such a
        sensor."""
        return self._rows[row][4]
