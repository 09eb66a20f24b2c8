"""What estimators cost in the whole tick of ``patrol_published``: none, the complementary filter, the Kalman filter.

Each row is a world of its own in one process, with the sensors that the estimator reads; without one the controller
flies on bare readings of the same sensors. Columns: worlds of so many vehicles; ns of CPU of a vehicle-step, and the
throughput over that without an estimator on the same sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import _common
import throughput

PLAIN: dict[str, Any] = {"gyroscope": {"type": "gyroscope"}, "accelerometer": {"type": "accelerometer"}}
FIELD: dict[str, Any] = {**PLAIN, "compass": {"type": "magnetometer"}}
AIR: dict[str, Any] = {**FIELD, "pitot": {"type": "airspeed"}}
EKF = {"type": "ekf"}
# What is measured: the estimator, and the sensors beside GNSS, barometer and attitude; the first of each set has none.
KINDS: dict[str, tuple[dict[str, Any] | None, dict[str, Any]]] = {
    "none": (None, PLAIN),
    "complementary": ({"type": "complementary"}, PLAIN),
    "ekf, 15 errors": (EKF, PLAIN),
    "none, magnetometer": (None, FIELD),
    "ekf, heading": ({**EKF, "magnetometer": "heading"}, FIELD),
    "ekf, 21 errors": (EKF, FIELD),
    "none, airspeed too": (None, AIR),
    "ekf, 24 errors": ({**EKF, "height_bias": True}, AIR),
}
PLACES = ((512, 8),)
HEADINGS = {
    "estimator": "estimator",
    "worlds": "worlds",
    "vehicles": "of",
    "ns": "tick [ns]",
    "throughput": "of that without",
    "compile_seconds": "compile [s]",
}


def world(count: int, kind: str) -> Any:
    """Return a world of the published patrol with ``count`` vehicles, sensors and an estimator."""
    from qrsim import load_scenario

    estimator, sensors = KINDS[kind]
    content = _common.patrol(count)
    fleet = content["fleets"]["pelicans"]
    for name in PLAIN:
        fleet["sensors"].pop(name, None)
    fleet["sensors"].update(sensors)
    if estimator is not None:
        fleet["estimator"] = estimator
    return load_scenario(content, quiet=True).world()


def measured(
    worlds: int, count: int, seconds: float, repeats: int, kinds: Sequence[str] = tuple(KINDS)
) -> list[dict[str, Any]]:
    """Return a row for each estimator, the medians of measurements; each is beside the last row without one."""
    rows: list[dict[str, Any]] = []
    bare = 0.0
    for kind in kinds:
        found = throughput._measured(world(count, kind), worlds, count, kind, seconds, repeats)
        ns = 1e9 / found["per_cpu_second"]
        bare = ns if KINDS[kind][0] is None else bare
        rows.append(
            {
                "estimator": kind,
                "worlds": worlds,
                "vehicles": count,
                "ns": ns,
                "throughput": bare / ns,
                "compile_seconds": found["compile_seconds"],
            }
        )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    _common.without_cache()
    on = _common.machine()
    if chosen.quick:
        rows = measured(2, 2, 0.01, 1, tuple(KINDS)[:3])
    else:
        rows = [row for place in PLACES for row in measured(*place, 0.4, 5)]
    title = "Estimators: single precision; compile: to the end of the first tick, nothing in a cache"
    _common.publish("estimators", title, on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
