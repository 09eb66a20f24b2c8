"""PX4 ULog, by pyulog: the topics that hold attitude, rates, velocity, battery and the set-points."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import LogError
from qrsim.studies.flight_logs.preparing import prepare
from qrsim.studies.flight_logs.signals import FlightLog, Floats, Track
from qrsim.studies.flight_logs.ulog_messages import open_ulog

# Signal, topic, the field that holds it (the first that is there), factor to SI. Of rows for the same signal the first
# whose topic is there counts: until 2019 PX4 logged the body rates with the attitude, and the thrust as a number.
FIELDS: tuple[tuple[str, str, tuple[str, ...], float], ...] = (
    ("roll_rate", "vehicle_angular_velocity", ("xyz[0]",), 1.0),
    ("pitch_rate", "vehicle_angular_velocity", ("xyz[1]",), 1.0),
    ("yaw_rate", "vehicle_angular_velocity", ("xyz[2]",), 1.0),
    ("roll_rate", "vehicle_attitude", ("rollspeed",), 1.0),
    ("pitch_rate", "vehicle_attitude", ("pitchspeed",), 1.0),
    ("yaw_rate", "vehicle_attitude", ("yawspeed",), 1.0),
    ("velocity_north", "vehicle_local_position", ("vx",), 1.0),
    ("velocity_east", "vehicle_local_position", ("vy",), 1.0),
    ("velocity_down", "vehicle_local_position", ("vz",), 1.0),
    ("yaw_rate_command", "vehicle_attitude_setpoint", ("yaw_sp_move_rate",), 1.0),
    # Upwards is negative in body axes.
    ("throttle", "vehicle_attitude_setpoint", ("thrust_body[2]",), -1.0),
    ("throttle", "vehicle_attitude_setpoint", ("thrust",), 1.0),
    ("battery", "battery_status", ("voltage_v", "voltage_filtered_v"), 1.0),
)
TOPICS = tuple(dict.fromkeys(("vehicle_attitude", *(topic for _, topic, _, _ in FIELDS))))


def read_ulog(path: Path) -> FlightLog:
    """Read a PX4 ULog flight log; a truncated file is read up to the cut, with a note.

    Raises:
        LogError: no ULog, or none of the topics.
        RunError: pyulog is not installed.
    """
    log, notes = open_ulog(path, list(TOPICS))
    if log.dropouts:
        lost = sum(dropout.duration for dropout in log.dropouts)
        notes.append(f"the logger lost data {len(log.dropouts)} times, {lost / 1000.0:.2f} s in all")
    # Of several instances of a topic, the first.
    topics = {data.name: data.data for data in reversed(log.data_list) if len(data.data.get("timestamp", ()))}
    if not topics:
        raise LogError(f"{path}: no data of the topics {', '.join(TOPICS)}")
    try:
        tracks = _tracks(topics, notes)
    except (KeyError, TypeError, ValueError) as error:  # a damaged definition, with other fields or types
        raise LogError(f"{path}: a ULog that cannot be read: its topics have no {error}") from None
    return prepare(path, "PX4 ULog", tracks, notes)


def _tracks(topics: Mapping[str, Mapping[str, NumpyArray]], notes: list[str]) -> dict[str, Track]:
    """Return signal name -> track in SI from the topics of a ULog; adds notes on choices between topics."""
    tracks: dict[str, Track] = {}

    def add(name: str, topic: str, values: Floats) -> None:
        """Add a column of a topic as the track of a signal."""
        tracks[name] = Track(topics[topic]["timestamp"] * 1e-6, np.asarray(values, np.float64))

    attitude = topics.get("vehicle_attitude")
    if attitude is not None and "q[3]" in attitude:
        for name, values in zip(("roll", "pitch", "yaw"), _euler(attitude, "q"), strict=True):
            add(name, "vehicle_attitude", values)
    asked = topics.get("vehicle_attitude_setpoint")
    if asked is not None and "roll_body" in asked and np.isfinite(asked["roll_body"]).any():
        add("roll_command", "vehicle_attitude_setpoint", asked["roll_body"])
        add("pitch_command", "vehicle_attitude_setpoint", asked["pitch_body"])
    elif asked is not None and "q_d[3]" in asked:
        roll, pitch, _ = _euler(asked, "q_d")
        add("roll_command", "vehicle_attitude_setpoint", roll)
        add("pitch_command", "vehicle_attitude_setpoint", pitch)
        notes.append("roll and pitch commands from the set-point's quaternion")
    for name, topic, choices, factor in FIELDS:
        there = [field for field in choices if topic in topics and field in topics[topic]]
        if there and name not in tracks:
            add(name, topic, factor * topics[topic][there[0]])
    return tracks


def _euler(data: Mapping[str, NumpyArray], name: str) -> tuple[Floats, Floats, Floats]:
    """Return ZYX Euler angles (roll, pitch, yaw) [rad] from a topic's quaternion ``name``, body to NED."""
    w, x, y, z = (np.asarray(data[f"{name}[{i}]"], np.float64) for i in range(4))
    return (
        np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0)),
        np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
