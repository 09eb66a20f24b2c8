"""Reading and state of the sensor ``gnss``."""

from __future__ import annotations

from typing import Any

from jax import Array

from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.apart import Apart
from qrsim.models.gnss.fixing import Link
from qrsim.models.gnss.hidden import Tracking
from qrsim.models.gnss.receivers import GnssReading

# Fields of a reading that are only there with per_satellite.
OF_SATELLITES = ("cn0", "satellite_state", "satellite", "azimuth", "elevation")


@record
class GnssFix(GnssReading):
    """Reading of a ``gnss`` receiver; its position and velocity, dilutions and accuracies are NaN without a fix."""

    fix_type: Array = quantity(
        unit="1",
        doc="type of the fix, as in MAVLink's GPS_FIX_TYPE: 0 none, 3 single, 4 SBAS or DGPS, 5 RTK float, 6 RTK fixed",
    )
    horizontal_accuracy: Array = quantity(
        unit="m", doc="standard deviation of the horizontal error, both axes together"
    )
    vertical_accuracy: Array = quantity(unit="m", doc="standard deviation of the vertical error")
    speed_accuracy: Array = quantity(unit="m/s", doc="standard deviation of the velocity error, all axes together")
    satellites_seen: Array = quantity(unit="1", doc="satellites above the mask")
    satellites_blocked: Array | None = quantity(
        default=None, unit="1", doc="number of these that obstacles hide; None in worlds without obstacles"
    )
    satellites_reflected: Array | None = quantity(
        default=None, unit="1", doc="number of these that are tracked by a reflection alone; None without obstacles"
    )
    correction_age: Array | None = quantity(
        default=None, unit="s", doc="age of the base station's corrections; None for receivers that take none"
    )
    jamming: Array | None = quantity(
        default=None, unit="1", doc="share of the C/N0 at the zenith that is lost to jammers; None without jammers"
    )
    satellites_jammed: Array | None = quantity(
        default=None, unit="1", doc="satellites above the mask that are lost to jammers; None without jammers"
    )
    # With per_satellite, for each of K slots (n,).
    cn0: tuple[Array, ...] | None = quantity(
        default=None, unit="dB-Hz", doc="C/N0 of the satellite in a slot, 0 where none is tracked"
    )
    satellite_state: tuple[Array, ...] | None = quantity(
        default=None,
        unit="1",
        doc="state of that satellite: 0 not tracked, 1 in line of sight, 2 by a reflection alone, 3 "
        "hidden, 4 lost to jammers",
    )
    satellite: tuple[Array, ...] | None = quantity(
        default=None, unit="1", doc="number of that satellite, see satellite_name; -1 in a free slot"
    )
    azimuth: tuple[Array, ...] | None = quantity(
        default=None, unit="rad", doc="azimuth of that satellite, clockwise from north"
    )
    elevation: tuple[Array, ...] | None = quantity(default=None, unit="rad", doc="elevation of that satellite")


@record
class GnssState:
    """State of n receivers."""

    geometry: Any = quantity(doc="Geometry that all of them share; None where receivers see different satellites")
    age: Any = quantity(doc="(K, n) time [s] for which each has seen a satellite, where they differ, else None")
    ids: Array = quantity(doc="(K,) uint32 number of the satellite in each slot")
    fast: Array = quantity(unit="1", doc="(K, n) multipath that changes soon")
    slow: Array = quantity(unit="1", doc="(K, n) multipath that stays")
    inner: Vec3 = quantity(unit="m", doc="error after the first lag")
    outer: Vec3 = quantity(unit="m", doc="error after the second lag: that of the fix")
    fixes: Array = quantity(unit="1", doc="fixes since the filter started")
    coasted: Array = quantity(unit="1", doc="periods without enough satellites")
    bias: tuple[Array, ...] = quantity(unit="m", doc="offset of each system but the first, relative to the first")
    true_ned: Vec3 = quantity(unit="m", doc="true position at the last fix")
    true_low_ned: Any = quantity(unit="m", doc="remainder of it beyond single precision, or None")
    ranges: Any = quantity(doc="(K,) or (K, n) error of the carrier at the last fix, where it is needed, else None")
    apart: Apart | None = quantity(doc="common errors where each receiver has its own, else None")
    history: tuple[GnssFix, ...] = quantity(doc="the last fixes, oldest first: as many as the delay, at least one")
    tracking: Tracking | None = quantity(default=None, doc="signals that obstacles have hidden; None without obstacles")
    link: Link | None = quantity(default=None, doc="corrections of a base station, None without any")
