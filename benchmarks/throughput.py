"""How many vehicle-steps a second, stage by stage: N vehicles in one world, and 512 worlds of 8.

The stages are cumulative: the dynamics of quadrotors that hold their attitude; + mean wind and full Dryden turbulence;
+ process noise; + barometer, attitude, gyroscope and accelerometer and the waypoint controller fed with them; + a GNSS
receiver at 5 Hz; + collisions between all vehicles, which is everything. Two stages follow that are not cumulative: the
wind for a multirotor by its rotors (an X500 in substeps of 4 ms) in place of the identified quadrotor, and the default
scenario ``outdoor_patrol`` (Kalman filter, IMU, magnetometer, sensor gnss, one field of gusts). ``--stages`` also takes
that of GNSS with velocities from Doppler (gnss-doppler), and with the sensor gnss under four constellations
(gnss-sensor).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import _common

VEHICLES = (1, 10, 100, 1000, 4096, 65536)
MANY_WORLDS = (512, 8)
STAGES = ("dynamics", "wind", "noise", "sensors", "gnss", "everything")
# Not cumulative: beside the stage of the wind, whose world it has.
ROTORS = "rotors"
# Not cumulative: the default scenario as it is, with more vehicles.
DEFAULT = "outdoor_patrol"
# Not cumulative either: that of GNSS with other receivers, and the skies they are made for.
RECEIVERS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "gnss-doppler": ({"type": "gnss_receiver", "velocity": "doppler"}, {}),
    "gnss-sensor": ({"type": "gnss"}, {}),
}
HEADINGS = {
    "stage": "stage",
    "worlds": "worlds",
    "vehicles": "vehicles in all",
    "per_wall_second": "vehicle-steps per wall second",
    "per_cpu_second": "per CPU second",
    "compile_seconds": "compile [s]",
}


def stage_world(count: int, stage: str) -> Any:
    """Return the world of a stage with ``count`` vehicles, of which none stops."""
    from qrsim import load_scenario

    if stage == DEFAULT:
        return load_scenario(_common.patrol(count, DEFAULT), quiet=True).world()
    content = _common.patrol(count)
    world, fleet = content["world"], content["fleets"]["pelicans"]
    world["turbulence"] = {"type": "dryden"}
    world["obstacles"] = [{"type": "cylinder", "x": 1e4, "y": 1e4, "radius": 1.0, "z_min": -10.0, "z_max": 0.0}]
    world["area"].update(x_min=-1e5, x_max=1e5, y_min=-1e5, y_max=1e5)
    place = STAGES.index("wind" if stage == ROTORS else "gnss" if stage in RECEIVERS else stage)
    if stage in RECEIVERS:
        fleet["sensors"]["gnss"], world["sky"] = RECEIVERS[stage]
    if place < STAGES.index("wind"):
        world["turbulence"], world["wind"] = {"type": "still"}, {"type": "calm"}
    if place < STAGES.index("noise"):
        fleet["vehicle"]["process_noise"] = 0.0
    if place < STAGES.index("sensors"):
        fleet["sensors"] = {}
        fleet["controller"] = {"type": "attitude", "feed": "truth"}
        fleet["guidance"] = {"type": "attitude"}
    elif place < STAGES.index("gnss"):
        fleet["sensors"]["gnss"] = {"type": "ideal_gnss"}
    if stage == ROTORS:
        # The cascade, since the published loops are of the identified quadrotor; both are fed with the truth.
        fleet["vehicle"] = {"type": "multirotor", "model": "x500", "downwash": "ignored"}
        fleet["controller"], fleet["guidance"] = {"type": "cascade", "feed": "truth"}, {"type": "route"}
    return load_scenario(content, quiet=True).world()


@contextmanager
def no_collisions(off: bool) -> Iterator[None]:
    """Let nobody look for collisions, if ``off``, which no scenario can ask for: for the cost of looking."""
    from qrsim.engine.programs import forget
    from qrsim.models.scene.area import Violation
    from qrsim.world import checking

    before = checking.collisions
    if off:
        checking.collisions = lambda position_ned, *_: Violation.first([], position_ned.x)
    forget()
    try:
        yield
    finally:
        checking.collisions = before


def measure(worlds: int, count: int, stage: str, seconds: float, repeats: int) -> dict[str, Any]:
    """Return the row of one stage.

    Args:
        worlds: how many, flown together.
        count: vehicles in each.
        stage: one of STAGES.
        seconds: wall time that one measurement should take.
        repeats: measurements, of which the median counts.
    """
    world = stage_world(count, stage)
    with no_collisions(off=stage not in ("everything", DEFAULT)):
        return _measured(world, worlds, count, stage, seconds, repeats)


def _measured(world: Any, worlds: int, count: int, stage: str, seconds: float, repeats: int) -> dict[str, Any]:
    import numpy as np

    flown = _common.Flown(world, worlds)
    ticks = flown.ticks_in(seconds)
    wall, cpu = np.median([flown.advance(ticks) for _ in range(repeats)], axis=0)
    steps = worlds * count * ticks
    return {
        "stage": stage,
        "vehicles": worlds * count,
        "worlds": worlds,
        "per_wall_second": round(steps / float(wall)),
        "per_cpu_second": round(steps / float(cpu)),
        "compile_seconds": round(flown.compiled.wall, 2),
        "ticks": ticks,
        "flying": flown.flying(),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, nargs="*", metavar="N", help="in one world (default: 1 to 65 536)")
    parser.add_argument(
        "--stages",
        nargs="*",
        choices=(*STAGES, ROTORS, DEFAULT, *RECEIVERS),
        default=(*STAGES, ROTORS, DEFAULT),
        help="which stages (default: all)",
    )
    parser.add_argument("--no-many-worlds", action="store_true", help="leave out the 512 worlds of 8 vehicles")
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")
    parser.add_argument("--quick", action="store_true", help="the smallest form; its numbers mean nothing")
    chosen = parser.parse_args(arguments)
    _common.without_cache()
    on = _common.machine()
    counts = chosen.vehicles or ((1,) if chosen.quick else VEHICLES)
    places = [(1, count) for count in counts]
    if not chosen.no_many_worlds:
        places.insert(0, (2, 2) if chosen.quick else MANY_WORLDS)
    seconds, repeats = (0.01, 1) if chosen.quick else (0.4, 5)
    stages = ("everything",) if chosen.quick else chosen.stages
    rows = [measure(worlds, count, stage, seconds, repeats) for worlds, count in places for stage in stages]
    if chosen.json:
        print(json.dumps({"benchmark": "throughput", "machine": on, "results": rows, "rows": rows}, indent=2))
        return
    title = "Throughput: single precision; compile: to the end of the first tick, nothing in a cache"
    _common.publish("throughput", title, on, rows, HEADINGS, as_json=False)


if __name__ == "__main__":
    main()
