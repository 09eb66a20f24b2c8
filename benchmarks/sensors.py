"""What inertial sensors cost in the whole tick of ``patrol_published``, what late delivery and others beside them add.

Each row is a world of its own in one process: with ``gyroscope`` and ``accelerometer``, with one ``imu`` in their
place, and with both of the former late by two periods. Columns: worlds of so many vehicles; ns of CPU of a
vehicle-step, and over the first row.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import _common
import throughput

PAIR: dict[str, dict[str, Any]] = {"gyroscope": {"type": "gyroscope"}, "accelerometer": {"type": "accelerometer"}}
KINDS: dict[str, dict[str, dict[str, Any]]] = {
    "gyroscope, accelerometer": PAIR,
    "imu": {"imu": {"type": "imu"}},
    "imu, vibration": {"imu": {"type": "imu", "vibration": "rotors"}},
    "none": {},
    "late by two periods": {name: {**sensor, "delay": 2} for name, sensor in PAIR.items()},
}
# Beside the pair.
BESIDE: dict[str, dict[str, Any]] = {
    "rangefinder": {"type": "rangefinder"},
    "scan": {"type": "scan"},
    "ranging to the fleet": {"type": "ranging"},
    "optical_flow": {"type": "optical_flow"},
    "neighbours": {"type": "neighbours"},
    "scan of 360 rays": {"type": "scan", "preset": "rplidar_a1"},
    "magnetometer": {"type": "magnetometer"},
    "pressure altimeter": {"type": "pressure_altimeter"},
    "airspeed": {"type": "airspeed"},
}
KINDS |= {f"+ {name}": {**PAIR, "beside": sensor} for name, sensor in BESIDE.items()}
PLACES = ((512, 8), (1, 1000))
HEADINGS = {
    "sensors": "sensors",
    "worlds": "worlds",
    "vehicles": "of",
    "ns": "tick [ns]",
    "over_pair": "over the pair",
    "compile_seconds": "compile [s]",
}


def world(count: int, kind: str) -> Any:
    """Return a world of the published patrol with ``count`` vehicles and other inertial sensors."""
    from qrsim import load_scenario

    content = _common.patrol(count)
    sensors = content["fleets"]["pelicans"]["sensors"]
    for name in PAIR:
        sensors.pop(name, None)
    sensors.update(KINDS[kind])
    return load_scenario(content, quiet=True).world()


def measured(
    worlds: int, count: int, seconds: float, repeats: int, kinds: Sequence[str] = tuple(KINDS)
) -> list[dict[str, Any]]:
    """Return a row for each set of sensors, the medians of measurements; the first is the pair."""
    rows: list[dict[str, Any]] = []
    for kind in kinds:
        found = throughput._measured(world(count, kind), worlds, count, kind, seconds, repeats)
        rows.append(
            {
                "sensors": kind,
                "worlds": worlds,
                "vehicles": count,
                "ns": 1e9 / found["per_cpu_second"],
                "compile_seconds": found["compile_seconds"],
            }
        )
    for row in rows:
        row["over_pair"] = row["ns"] / rows[0]["ns"]
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    _common.without_cache()
    on = _common.machine()
    if chosen.quick:
        rows = measured(2, 2, 0.01, 1, tuple(KINDS)[:2])
    else:
        rows = [row for place in PLACES for row in measured(*place, 0.4, 5)]
    title = "Inertial sensors: single precision; compile: to the end of the first tick, nothing in a cache"
    _common.publish("sensors", title, on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
