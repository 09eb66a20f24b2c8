"""The practical limits: the full-noise step without GNSS and the Kalman filter, each written by hand in C++ in vectors.

``bound.cc`` is compiled here, checked against this package (random words, normals, and whole ticks of 16 vehicles), and
then timed in the same run: its 4096 vehicles do not see each other; the package flies 512 worlds of 8, collisions
included. ``filter_bound.cc`` is the filter of the default scenario alone, checked and timed on the same readings.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import _common
import _filter_bound

SOURCE = Path(__file__).with_name("bound.cc")
COMPILER = "g++"
INSTALL = "sudo apt-get install g++"
FLAGS = ("-O3", "-march=native", "-fschedule-insns", "-std=c++17", "-fno-math-errno", "-fno-trapping-math", "-pthread")
LANES = 16
WORLDS, VEHICLES = 512, 8
STREAMS = ("turbulence", "process", "barometer", "attitude", "gyroscope", "accelerometer")
HEADINGS = {
    "program": "program",
    "vehicles": "vehicles",
    "threads": "threads",
    "per_wall_second": "per wall second",
    "per_cpu_second": "per CPU second",
    "of_bound_wall": "of bound (wall)",
    "of_bound_cpu": "of bound (CPU)",
}


class Nothing:
    """Metrics that sum up nothing of a flight but which vehicles fly at its end."""

    def init(self, world: Any, state: Any) -> tuple[()]:
        """Return no memory."""
        return ()

    def update(self, flight: Any, world: Any, state: Any, tick: Any) -> tuple[()]:
        """Return no memory."""
        return ()

    def finish(self, flight: Any, world: Any, state: Any) -> dict[str, Any]:
        """Return which vehicles (W, n) fly."""
        return {"flying": np.concatenate([fleet.violation.code for fleet in state.fleets], axis=-1) == 0}


def scenario(count: int) -> dict[str, Any]:
    """Return the scenario that bound.cc flies: full Dryden turbulence, and the true position at 5 Hz for GNSS."""
    content = _common.patrol(count)
    content["world"]["turbulence"] = {"type": "dryden"}
    content["fleets"]["pelicans"]["sensors"]["gnss"] = {"type": "ideal_gnss"}
    return content


def compiled(folder: Path, source: Path | None = None) -> Path:
    """Compile bound.cc, or another source, and return the program.

    Raises:
        SystemExit: there is no compiler, or it failed.
    """
    if shutil.which(COMPILER) is None:
        sys.exit(f"bound: the C++ compiler {COMPILER} is not installed: {INSTALL}")
    source = source or SOURCE
    program = folder / source.stem
    done = subprocess.run([COMPILER, *FLAGS, "-o", program, source], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"bound: {COMPILER} failed:\n{done.stderr}")
    return program


def asked(program: Path, *arguments: object, given: str = "") -> list[list[str]]:
    """Return the words of each line that the program prints."""
    command = [str(program), *map(str, arguments)]
    printed = subprocess.run(command, input=given, capture_output=True, text=True, check=True).stdout
    return [line.split() for line in printed.splitlines()]


def check_noise(program: Path) -> None:
    """Compare random words and normals with the package's.

    Raises:
        SystemExit: they differ.
    """
    import jax.numpy as jnp

    from qrsim.core.noise import Stream

    ids = jnp.arange(64, dtype=jnp.uint32)
    for high, low, tick in ((0, 0, 0), (0xDEADBEEF, 0x12345678, 1), (0xFFFFFFFF, 0xFFFFFFFF, 2**31 - 1)):
        stream = Stream(jnp.uint32(high), jnp.uint32(low), ids)
        theirs = asked(program, "words", high, low, tick, len(ids))
        words = np.array([line[:2] for line in theirs], np.uint32).T
        normals = np.array([line[2:] for line in theirs], np.float32).T
        if not np.array_equal(words, np.array(stream.words(jnp.uint32(tick), 0))):
            sys.exit("bound: its random words are not those of qrsim.core.noise")
        if not np.allclose(normals, np.array(stream.normals(jnp.uint32(tick), 2, jnp.float32)), rtol=1e-5, atol=2e-6):
            sys.exit("bound: its normals are not those of qrsim.core.noise")


def fields(world: Any, state: Any) -> dict[str, Any]:
    """Return what both programs know of each vehicle (16,), by the names of bound.cc."""
    fleet, route = state.fleets[0], world.fleets[0].route
    readings = dict(zip(world.fleets[0].sensor_names, fleet.readings, strict=True))
    memories = dict(zip(world.fleets[0].sensor_names, fleet.sensors, strict=True))
    gnss, attitude, gusts, body = readings["gnss"], readings["attitude"].attitude, fleet.turbulence, fleet.vehicle
    gyro, force = readings["gyroscope"].rates_body, readings["accelerometer"].specific_force
    error, goal = memories["attitude"].error, fleet.setpoint
    values = {
        "north east down": body.position_ned, "roll pitch yaw": body.attitude, "u v w": body.velocity_body,
        "p q r": body.rates_body, "across1 across2 across3": gusts.across, "down1 down2 down3": gusts.down,
        "air_north air_east air_down": fleet.mean_wind_ned + fleet.gust_ned,
        "spin_north spin_east spin_down": fleet.gust_rates_ned, "integral error z_wanted": fleet.controller,
        "goal_north goal_east goal_down": goal.position_ned, "index reached": fleet.guidance,
        "roll_error pitch_error yaw_error": error, "gnss_north gnss_east gnss_down": gnss.position_ned,
        "gnss_vn gnss_ve gnss_vd": gnss.velocity_ned, "roll_read pitch_read yaw_read": attitude,
        "gyro_x gyro_y gyro_z": gyro, "acc_x acc_y acc_z": force, "code value": fleet.violation,
    }  # fmt: skip
    named = {"thrust": body.thrust, "along": gusts.along, "roll_gust": gusts.roll, "goal_yaw": goal.yaw}
    named |= {"drift": memories["barometer"].drift, "height": readings["barometer"].height}
    named |= {"height_rate": readings["barometer"].height_rate, "throttle": fleet.command.throttle}
    named |= {"pitch_wanted": fleet.command.pitch, "roll_wanted": fleet.command.roll}
    named |= {"turn_wanted": fleet.command.yaw_rate}
    for names, group in values.items():
        named |= dict(zip(names.split(), (part for part in vars(group).values() if part is not None), strict=True))
    for k in range(4):
        ways = (route.position_ned.x[k], route.position_ned.y[k], route.position_ned.z[k], route.yaw[k])
        named |= {f"w{4 * k + j}": way for j, way in enumerate(ways)}
    return {name: np.asarray(value, np.float64) for name, value in named.items()}


def check_ticks(program: Path, speed_20ft: float, first: int, ticks: int, tolerance: float) -> float:
    """Compare some ticks of 16 vehicles with the package's, noise and sensors included.

    Args:
        program: the compiled bound.cc.
        speed_20ft: wind [m/s].
        first: tick at which the package hands its state over.
        ticks: flown by both from there.
        tolerance: relative, and for what is near zero absolute in its own unit.

    Returns:
        The largest difference in these terms.

    Raises:
        SystemExit: it is above the tolerance.
    """
    import qrsim

    content = scenario(LANES)
    content["world"]["wind"]["speed_20ft"] = speed_20ft
    content["world"]["area"].update(x_min=-1e5, x_max=1e5, y_min=-1e5, y_max=1e5)
    sim = qrsim.load(content, seed=5)
    sim.reset()
    sim.step(ticks=first)
    keys = sim.state.fleet_keys[0]
    order = ("turbulence", "process", *sim.world.fleets[0].sensor_names)
    lines = [f"{keys.high[order.index(name)]} {keys.low[order.index(name)]}" for name in STREAMS]
    before = fields(sim.world, sim.state)
    lines += [f"{name} {' '.join(f'{number:.9g}' for number in numbers)}" for name, numbers in before.items()]
    printed = asked(program, "check", first, ticks, speed_20ft, given="\n".join(lines))
    theirs = {name: np.array(numbers, np.float64) for name, *numbers in printed}
    sim.step(ticks=ticks)
    ours = fields(sim.world, sim.state)
    if set(theirs) != set(ours):
        sys.exit(f"bound: fields differ: {sorted(set(theirs) ^ set(ours))}")
    # The position of the C++ has one part: a height may be rounded otherwise, and a rate is two of them over a tick.
    allowed = {"height_rate": 2.0 * np.spacing(np.abs(ours["height"]).astype(np.float32)) / sim.world.time_step}
    off = {
        name: float(np.max((np.abs(theirs[name] - ours[name]) - allowed.get(name, 0.0)) / (1.0 + np.abs(ours[name]))))
        for name in ours
    }
    worst = max(off, key=lambda name: off[name])
    if not all(value <= tolerance for value in off.values()):
        sys.exit(f"bound: {ticks} ticks at {speed_20ft:g} m/s of wind differ from qrsim's: {worst} by {off[worst]:.2g}")
    return off[worst]


def published_rows(program: Path, counts: Sequence[int], quick: bool) -> list[dict[str, Any]]:
    """Return the rows of the published set, those by hand with each number of threads and last that of this package.

    All are measured in turns. A rollout is timed whole, from its start to its metrics.
    """
    import qrsim

    worlds, ticks, repeats = (2, 10, 1) if quick else (WORLDS, 500, 7)
    by_hand_ticks = 2 if quick else ticks
    world = qrsim.load_scenario(scenario(VEHICLES), quiet=True).world()
    # One object, because programs are compiled for their metrics.
    metrics = Nothing()
    by_hand: dict[int, list[list[float]]] = {count: [] for count in counts}
    own = []
    for repeat in range(repeats + 1):  # the first one compiles
        for count, rows in by_hand.items():
            printed = asked(program, "run", WORLDS * VEHICLES, by_hand_ticks, 2, count)
            rows += [list(map(float, line)) for line in printed] if repeat else []
        wall, cpu = time.perf_counter(), time.process_time()
        result = qrsim.rollout(world, ticks=ticks, worlds=worlds, metrics=metrics)
        own += [[time.perf_counter() - wall, time.process_time() - cpu]] if repeat else []
    kernels = [
        row(SOURCE.name, count, by_hand_ticks, *np.array(rows).T[:2], int(rows[-1][2]))
        for count, rows in by_hand.items()
    ]
    flying = int(result["flying"].sum())
    return [*kernels, row("qrsim", counts[-1], ticks, *np.array(own).T, flying, worlds * VEHICLES)]


def filter_rows(program: Path, threads: int, quick: bool) -> list[dict[str, Any]]:
    """Return the rows of the Kalman filter alone, by hand and of this package."""
    worlds, ticks, repeats = (2, 10, 1) if quick else (WORLDS, 100, 7)
    timed = _filter_bound.timed(asked, program, threads, worlds, VEHICLES, ticks, repeats)
    names = _filter_bound.SOURCE.name, "qrsim, filter alone"
    return [
        row(name, threads, ticks, np.array(each.walls), np.array(each.cpus), each.finite, worlds * VEHICLES)
        for name, each in zip(names, timed, strict=True)
    ]


def with_ratios(results: list[dict[str, Any]], by_hand: dict[str, Any]) -> list[dict[str, Any]]:
    """Return rows with their speed over that of a row by hand."""
    return [
        {
            **result,
            **{
                f"of_bound_{clock}": result[f"per_{clock}_second"] / by_hand[f"per_{clock}_second"]
                for clock in ("wall", "cpu")
            },
        }
        for result in results
    ]


def row(
    program: str, threads: int, ticks: int, walls: Any, cpus: Any, flying: int, vehicles: int = WORLDS * VEHICLES
) -> dict[str, Any]:
    """Return a row; the median of the measurements counts."""
    steps = vehicles * ticks
    return {
        "program": program,
        "vehicles": vehicles,
        "threads": threads,
        "ticks": ticks,
        "per_wall_second": round(steps / float(np.median(walls))),
        "per_cpu_second": round(steps / float(np.median(cpus))),
        "flying": flying,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Compile, check, measure and print."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--check", action="store_true")
    only_check, rest = parser.parse_known_args(arguments)
    chosen = _common.options(__doc__.splitlines()[0] + " --check: compare with the package, and nothing else.", rest)
    _common.without_cache()
    on = _common.machine()
    with tempfile.TemporaryDirectory() as folder:
        program = compiled(Path(folder))
        filtering = compiled(Path(folder), _filter_bound.SOURCE)
        check_noise(program)
        cases = [(5.0, 40, 1, 1e-4)] if chosen.quick else [(5.0, 40, 1, 1e-4), (5.0, 40, 400, 1e-2), (40.0, 1, 1, 1e-4)]
        worst = [check_ticks(program, *case) for case in cases]
        of_filter = _filter_bound.check(asked, filtering, 100)
        if only_check.check:
            print(f"bound: words equal, normals to 1e-5, ticks to {', '.join(f'{off:.1g}' for off in worst)}")
            print(f"filter: states after 100 ticks to {of_filter:.1g}")
            return
        cores = os.cpu_count() or 1
        counts = (1,) if chosen.quick or cores == 1 else (1, cores)
        published = published_rows(program, counts, chosen.quick)
        filters = filter_rows(filtering, counts[-1], chosen.quick)
    results = [*with_ratios(published, published[-2]), *with_ratios(filters, filters[0])]
    title = "Bound: vehicle-steps per second without GNSS, and of the filter alone; single precision"
    _common.publish("bound", title, on, results, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
