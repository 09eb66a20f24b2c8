"""What a policy costs in a rollout: compiled into the loop, in NumPy, with a memory, and one for each team."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import _common

WORLDS, TICKS = (1, 16, 128), 100
SENSORS = {
    "gnss": "gnss_receiver",
    "barometer": "barometer",
    "attitude": "attitude_estimator",
    "gyroscope": "gyroscope",
    "accelerometer": "accelerometer",
}
HEADINGS = {
    "policy": "policy",
    "worlds": "worlds",
    "vehicles": "vehicles",
    "per_wall_second": "vehicle-steps/s",
    "microseconds_a_call": "us a call",
}


def world() -> Any:
    """Return two teams of five vehicles, with the sensors and the turbulence of the published patrol."""
    import qrsim

    teams = {
        name: {"sensors": SENSORS, "vehicles": [[north, 20.0 * i, -20.0] for i in range(5)]}
        for name, north in (("scouts", 0.0), ("cats", 60.0))
    }
    return qrsim.make_world(
        fleets=teams, wind={"type": "log_shear", "speed_20ft": 3.0, "wind_from_deg": 270}, turbulence="dryden"
    )


def policies() -> dict[str, Any]:
    """Return by name what flies both teams to places 5 m north of where their receivers say they are."""
    import jax
    import numpy as np

    import qrsim

    def ahead(reading: Any) -> Any:
        return qrsim.WaypointSetpoint.of(reading.gnss.position_ned + np.array([[5.0, 0.0, 0.0]], np.float32), 0.0)

    class Ahead:
        """The same, in an object that each world has for itself."""

        def __call__(self, reading: Any) -> Any:
            return ahead(reading)

    def both(reading: Any) -> Any:
        return {name: ahead(reading.of(name)) for name in reading.fleets}

    return {
        "none, the fleets' own guidance": None,
        "compiled (jax.jit)": jax.jit(both),
        "compiled, one for each team": {"scouts": jax.jit(ahead), "cats": jax.jit(ahead)},
        "NumPy function": both,
        "NumPy, one for each team": {"scouts": ahead, "cats": ahead},
        "NumPy class, one for each team": {"scouts": Ahead, "cats": Ahead},
    }


def row(name: str, policy: Any, flown: Any, worlds: int, ticks: int) -> dict[str, Any]:
    """Return the row of one policy; a first flight of the same length, which compiles, is not counted."""
    import qrsim

    taken = []
    for _ in range(3):
        begun = time.perf_counter()
        qrsim.rollout(flown, policy, worlds=worlds, ticks=ticks)
        taken.append(time.perf_counter() - begun)
    least = min(taken[1:])
    return {
        "policy": name,
        "worlds": worlds,
        "vehicles": 10,
        "per_wall_second": round(worlds * ticks * 10 / least),
        "microseconds_a_call": round(1e6 * least / (worlds * ticks), 2),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    flown, ticks, counts = world(), TICKS, WORLDS
    if chosen.quick:
        ticks, counts = 5, (1,)
    results = [row(name, policy, flown, count, ticks) for count in counts for name, policy in policies().items()]
    _common.publish("policies", "Policies in rollouts, two teams of five", on, results, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
