"""One world of 1 to a million vehicles, on 1 to all threads: vehicle-steps a second, by the wall and per CPU second.

The world has all that ``throughput.py`` measures: gusts, noise, sensors, receivers, controller and collisions. The last
row is of 512 worlds of 8 on all threads, which one column compares with. The rows of a number of vehicles are measured
in turns, and the median of each counts, because other processes come and go. Each row has its own process, since a
process has one number of threads. The column "state" has the first digits of a digest of the state after some ticks,
which must be the same for all numbers of threads.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from statistics import median
from typing import Any

import _common

VEHICLES = (1, 16, 256, 1024, 4096, 65536, 1_000_000)
MANY_WORLDS = (512, 8)
# Vehicles that one scenario may have, and ticks before the first measurement.
LARGEST_PART = 65536
TICKS = 10
HEADINGS = {
    "worlds": "worlds",
    "vehicles": "vehicles in each",
    "threads": "threads",
    "per_wall_second": "vehicle-steps per wall second",
    "per_cpu_second": "per CPU second",
    "over_many_worlds": "wall, over 512 x 8",
    "megabytes": "largest memory [MB]",
    "state": "state",
}


def large_world(count: int) -> Any:
    """Return a world of throughput's last stage; of more vehicles than a scenario may have, from copies of a part."""
    import dataclasses

    import jax
    import numpy as np

    from throughput import stage_world

    tiles = math.ceil(math.sqrt(math.ceil(count / LARGEST_PART)))
    size = count // tiles**2
    world = stage_world(size, "everything")
    if tiles == 1:
        return world
    fleet = jax.tree.map(
        lambda leaf: np.tile(leaf, tiles**2) if np.shape(leaf)[-1:] == (size,) else leaf, world.fleets[0]
    )
    # Side by side, each in its own square.
    side = math.ceil(math.sqrt(size)) * _common.SPACING
    places = np.repeat(np.arange(tiles**2), size)
    north, east = (((place - (tiles - 1) / 2) * side).astype(np.float32) for place in np.divmod(places, tiles))
    for part in ("start", "route"):
        held = getattr(fleet, part)
        moved = dataclasses.replace(
            held.position_ned, x=np.asarray(held.position_ned.x) + north, y=np.asarray(held.position_ned.y) + east
        )
        fleet = dataclasses.replace(fleet, **{part: dataclasses.replace(held, position_ned=moved)})
    fleet = dataclasses.replace(fleet, vehicle_names=tuple(map(str, range(size * tiles**2))))
    return dataclasses.replace(world, fleets=(fleet,))


def served(arguments: Sequence[str]) -> None:
    """Fly one world, or many, in this process: a line of JSON for each line that is read, until there is no more."""
    import jax
    import numpy as np

    import qrsim
    from qrsim.core.noise import Key
    from qrsim.simulation.many_worlds import Flight
    from qrsim.simulation.rollout import setup_of
    from qrsim.world.draws import keys_of

    worlds, count, threads = map(int, arguments[:3])
    seconds = float(arguments[3])
    qrsim.configure(cpu_devices=threads)
    world = large_world(count)
    count = world.fleets[0].size
    setup, fixed, own = setup_of([world], metrics=_common.Nothing())
    keys = keys_of(world, Key.roots(np.zeros(worlds, np.int64), np.arange(worlds)))
    flight = Flight(setup, fixed, own, keys, count, 1)
    flight.advance(0, TICKS, ((), ()))
    tick, digest = TICKS, hashlib.sha256()
    for leaf in jax.tree.leaves(flight.get(lambda carry: carry.state)):
        digest.update(np.asarray(leaf).tobytes())
    ticks = TICKS
    for _ in sys.stdin:
        begin, cpu = time.perf_counter(), time.process_time()
        flight.advance(tick, ticks, ((), ()))
        wall, cpu = time.perf_counter() - begin, time.process_time() - cpu
        tick += ticks
        steps = worlds * count * ticks
        row = {
            "per_wall_second": steps / wall,
            "per_cpu_second": steps / max(cpu, 1e-9),
            "state": digest.hexdigest()[:8],
        }
        row["megabytes"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
            1e6 if sys.platform == "darwin" else 1e3
        )
        # The first line finds out how many ticks take the time that was asked for.
        ticks = max(1, min(100_000, round(ticks * seconds / wall)))
        print(json.dumps(row), flush=True)


class Flown:
    """A process that flies worlds when it is asked to.

    Args:
        worlds: how many.
        count: vehicles in each.
        threads: that it may use.
        seconds: wall time of a measurement.
    """

    def __init__(self, worlds: int, count: int, threads: int, seconds: float):
        self.row: dict[str, Any] = {"worlds": worlds, "vehicles": count, "threads": threads}
        self.rows: list[dict[str, Any]] = []
        command = [sys.executable, __file__, "--serve", *map(str, (worlds, count, threads, seconds))]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.measure()
        self.rows.clear()

    def measure(self) -> None:
        """Measure once."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"the process of {self.row} ended")
        self.rows.append(json.loads(line))

    def end(self) -> dict[str, Any]:
        """End the process, and return the medians."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()
        found = {
            name: median(row[name] for row in self.rows) for name in ("per_wall_second", "per_cpu_second", "megabytes")
        }
        return {**self.row, **{name: round(value) for name, value in found.items()}, "state": self.rows[0]["state"]}


def measured(counts: Sequence[int], threads: Sequence[int], seconds: float, repeats: int, many: tuple[int, int]) -> Any:
    """Yield the rows of each number of vehicles, those of all numbers of threads measured in turns.

    Args:
        counts: vehicles in a world.
        threads: numbers of threads.
        seconds: wall time of a measurement.
        repeats: measurements of each row.
        many: worlds and vehicles that the last column compares with.
    """
    reference = Flown(*many, threads[-1], seconds)
    for count in counts:
        flown = [Flown(1, count, each, seconds) for each in threads]
        reference.rows.clear()
        for _ in range(repeats):
            for each in (*flown, reference):
                each.measure()
        base = median(row["per_wall_second"] for row in reference.rows)
        rows = [each.end() for each in flown]
        for row in rows:
            row["over_many_worlds"] = round(row["per_wall_second"] / base, 3)
        if len({row["state"] for row in rows}) > 1:
            raise SystemExit(f"{count} vehicles: the states differ: {rows}")
        yield from rows
    yield {**reference.end(), "over_many_worlds": 1.0}


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] == ["--serve"]:
        served(given[1:])
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, nargs="*", metavar="N", help="in one world (default: 1 to a million)")
    parser.add_argument("--threads", type=int, nargs="*", metavar="N", help="numbers of threads (default: 1 to all)")
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")
    parser.add_argument("--quick", action="store_true", help="the smallest form; its numbers mean nothing")
    chosen = parser.parse_args(given)
    _common.without_cache()
    on = _common.machine()
    cores = os.cpu_count() or 1
    counts = chosen.vehicles or ((1,) if chosen.quick else VEHICLES)
    threads = chosen.threads or ((1,) if chosen.quick else range(1, cores + 1))
    seconds, repeats = (0.01, 1) if chosen.quick else (0.5, 7)
    many = (2, 2) if chosen.quick else MANY_WORLDS
    rows = list(measured(counts, list(threads), seconds, repeats, many))
    title = "One world on several threads: single precision"
    _common.publish("one_world", title, on, rows, HEADINGS, as_json=chosen.json)


if __name__ == "__main__":
    main()
