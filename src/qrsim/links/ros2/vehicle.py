"""What is published of one vehicle: its topics, and their messages as bytes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any

from qrsim.links.ros2 import Message, variances
from qrsim.links.ros2 import numbers as n
from qrsim.links.ros2 import topics as t
from qrsim.links.ros2.blank import empty
from qrsim.links.ros2.names import base_link
from qrsim.links.ros2.template import Template
from qrsim.links.ros2.topics import STAMP, Kind, Topic, frame_of
from qrsim.links.ros2.typestore import Types
from qrsim.links.shared import sight as s
from qrsim.models.gnss.sensor import Gnss
from qrsim.models.sensors.rangefinder import FARTHEST, Rangefinder

# sensor_msgs: NavSatStatus.SERVICE_* by the letter of a system; BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
# POWER_SUPPLY_HEALTH_GOOD, POWER_SUPPLY_TECHNOLOGY_LIPO; Range.INFRARED; NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN.
_SERVICES = {"G": 1, "R": 2, "C": 4, "E": 8}
_DISCHARGING, _GOOD, _LIPO, _INFRARED, _KNOWN = 2, 1, 3, 1, 2
NAN = math.nan
# Finds the sensor that a column (shared/sight.py) of the vehicle is of, or None.
Sensors = Callable[[int], Any]


class Publication:
    """One topic of one vehicle.

    Args:
        types: of the distribution.
        kind: of topic.
        namespace: of the vehicle.
        sensors: of the vehicle.
        number: of the vehicle in its fleet.

    Attributes:
        kind, topic: what it is.
        needs: columns without whose numbers nothing is published.
        sensor: column whose sensor sets the pace, or None.
        cdr: the last message, with the header of CDR.
        stamp, puts, status: slots of ``Template`` for the time, for numbers with their columns, and for a fix's status.
    """

    def __init__(self, types: Types, kind: Kind, namespace: str, sensors: Sensors, number: int):
        self.kind = kind
        self.topic = Topic(f"/{namespace}/{kind.topic}", kind.type, kind.quality)
        self.needs, self.sensor = kind.needs, kind.sensor
        # What an Imu message of this vehicle does not have.
        without: tuple[str, ...] = ()
        if kind is t.IMU:
            self.needs, self.sensor, without = _of_imu(sensors)
        message = empty(types, kind.type)
        stamped = "header" in dict(types.fields(kind.type))
        if stamped:
            message.header.frame_id = frame_of(kind, namespace)
        if kind.child:
            message.child_frame_id = base_link(namespace)
        _CONSTANTS.get(kind.topic, _no_constants)(message, sensors, number)
        template = Template(types, message)
        puts = [
            (path, columns)
            for path, columns in kind.puts
            if path.partition("[")[0] in template.places and not path.startswith(without)
        ]
        order = [column for _, columns in puts for column in columns]
        self._pick = itemgetter(*order) if len(order) > 1 else lambda row: (row[order[0]],)
        self._put = template.putter(*(STAMP if stamped else ()), *(path for path, _ in puts))
        self._stamped, self.cdr = stamped, template.cdr
        self._status = template.putter("status.status") if "status.status" in template.places else None
        self.stamp = [template.slot(path) for path in STAMP] if stamped else []
        self.puts = [(template.slot(path), columns) for path, columns in puts]
        self.status = template.places.get("status.status")

    def message(self, row: Sequence[float], sec: int, nanosec: int) -> bytes | None:
        """Return the CDR message for a row of numbers at a time (s, ns); None if a number that it needs is unknown."""
        for column in self.needs:
            if row[column] != row[column]:
                return None
        if self._stamped:
            self._put(sec, nanosec, *self._pick(row))
        else:
            self._put(*self._pick(row))
        if self._status is not None:
            self._status(int(row[n.FIX_STATUS]))
        return bytes(self.cdr)

    @property
    def form(self) -> tuple[object, ...]:
        """Key that is equal for messages which differ only in constants, so that they can be written together."""
        puts = tuple((slot, tuple(columns)) for slot, columns in self.puts)
        return self.kind.topic, len(self.cdr), tuple(self.stamp), puts, self.status, tuple(self.needs), self.sensor


def kinds_of(sensors: Sensors, drains: bool, windy: bool) -> list[Kind]:
    """Return the kinds of messages that a vehicle with these sensors publishes; ``drains``: it has a battery,
    ``windy``: it estimates the wind.

    Args:
        sensors: of the vehicle.
        drains: whether it has a battery that drains.
        windy: whether its estimator knows a wind.
    """
    there = {t.BATTERY: drains, t.WIND: windy, t.IMU: any(sensors(column) is not None for column in (s.RATES, s.FORCE))}
    return [kind for kind in t.KINDS if there.get(kind, kind.sensor is None or sensors(kind.sensor) is not None)]


def _of_imu(sensors: Sensors) -> tuple[tuple[int, ...], int, tuple[str, ...]]:
    """Return an Imu message's column groups, the column whose sensor times it, and the fields that no sensor fills."""
    gyroscope, accelerometer = sensors(s.RATES) is not None, sensors(s.FORCE) is not None
    if gyroscope and accelerometer:
        return (n.RATES, n.FORCE), s.RATES, ()
    if gyroscope:
        return (n.RATES,), s.RATES, ("linear_acceleration",)
    return (n.FORCE,), s.FORCE, ("angular_velocity",)


def _no_constants(message: object, sensors: Sensors, number: int) -> None:
    """Do nothing, for messages that have no constant fields."""


def _set_fix(message: Message, sensors: Sensors, number: int) -> None:
    """Set the constant fields of a NavSatFix message: satellite systems and covariance type."""
    receiver = sensors(s.FIX_POSITION)
    message.status.service = _SERVICES["G"]
    if isinstance(receiver, Gnss):
        message.status.service = sum(_SERVICES.get(letter, 0) for letter in receiver.systems)
    message.position_covariance_type = _KNOWN if sensors(s.HORIZONTAL) is not None else 0


def _set_inertial(message: Message, sensors: Sensors, number: int) -> None:
    """Set an Imu message's covariances from the noise of vehicle ``number``'s sensors; -1 where a sensor is missing."""
    for covariance, column, variance in (
        (message.angular_velocity_covariance, s.RATES, variances.of_rates),
        (message.linear_acceleration_covariance, s.FORCE, variances.of_force),
    ):
        sensor = sensors(column)
        covariance[[0, 4, 8]] = variance(sensor, number)
        if sensor is None:
            covariance[:] = 0.0
            covariance[0] = -1.0


def _set_field(message: Message, sensors: Sensors, number: int) -> None:
    """Set a MagneticField message's covariance from the noise of vehicle ``number``'s magnetometer."""
    message.magnetic_field_covariance[[0, 4, 8]] = variances.of_field(sensors(s.FIELD), number)


def _set_pressure(message: Message, sensors: Sensors, number: int) -> None:
    """Set a FluidPressure message's variance from the noise of vehicle ``number``'s barometer."""
    message.variance = variances.of_pressure(sensors(s.PRESSURE), number)


def _set_range(message: Message, sensors: Sensors, number: int) -> None:
    """Set a Range message's limits and radiation type from vehicle ``number``'s rangefinder."""
    sensor = sensors(s.RANGE)
    message.radiation_type = _INFRARED
    message.min_range, message.max_range = 0.0, FARTHEST
    if isinstance(sensor, Rangefinder):
        message.min_range = variances.own(sensor.range_min, number)
        message.max_range = variances.own(sensor.range_max, number)


def _set_battery(message: Message, sensors: Sensors, number: int) -> None:
    """Set the constant fields of a BatteryState message; quantities that are not measured are NaN."""
    # What is not measured is NaN (sensor_msgs/BatteryState).
    message.temperature = message.current = message.charge = message.capacity = message.design_capacity = NAN
    message.power_supply_status, message.power_supply_health = _DISCHARGING, _GOOD
    message.power_supply_technology, message.present = _LIPO, True


_CONSTANTS: dict[str, Callable[[Message, Sensors, int], None]] = {
    t.FIX.topic: _set_fix,
    t.IMU.topic: _set_inertial,
    t.MAG.topic: _set_field,
    t.BARO.topic: _set_pressure,
    t.RANGE.topic: _set_range,
    t.BATTERY.topic: _set_battery,
}
