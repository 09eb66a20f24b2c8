"""What the benchmarks share: options, the machine they run on, the world they fly, and how they print."""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

HEIGHTS = (20.0, 30.0, 40.0, 50.0, 60.0)
SPACING = 80.0
SIDE = 40.0
# An action of keep_spot that hovers, in [-1, 1]: pitch, roll, throttle, yaw rate and battery.
HOVER = (0.0, 0.0, 0.0, 0.0, 1.0)


def options(description: str, arguments: Sequence[str] | None = None, **more: str) -> argparse.Namespace:
    """Return the options ``json`` and ``quick``.

    Args:
        description: what is measured.
        arguments: the command line, by default that of the process.
        more: further options that take a text, with their help.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="the smallest form, to see that the benchmark works; its numbers mean nothing",
    )
    for name, words in more.items():
        parser.add_argument(f"--{name}", help=words)
    return parser.parse_args(arguments)


def count_of(text: str) -> int:
    """Return a count that was given as an option.

    Raises:
        SystemExit: it is no number above zero.
    """
    if not text.isdecimal() or int(text) < 1:
        raise SystemExit(f"--vehicles: '{text}' is no number of vehicles: 1 or more, as in --vehicles 30")
    return int(text)


def without_cache() -> None:
    """Compile every program in this process, to better code at once; call it before the first simulation is made."""
    os.environ["QRSIM_COMPILATION_CACHE"] = "off"
    os.environ.setdefault("QRSIM_TIER", "better")
    os.environ.pop("JAX_COMPILATION_CACHE_DIR", None)


def patrol(count: int, scenario: str = "patrol_published") -> dict[str, Any]:
    """Return a patrol of ``count`` vehicles, each on a square of its own, in an area that holds them.

    Args:
        count: number of vehicles.
        scenario: whose wind, turbulence, sensors and controller they have; ``patrol_published`` never changes.
    """
    import qrsim

    content = qrsim.load_scenario(scenario).spec.model_dump(mode="json")
    columns = math.ceil(math.sqrt(count))
    vehicles = []
    for i in range(count):
        north, east = ((k - (columns - 1) / 2) * SPACING for k in divmod(i, columns))
        down = -HEIGHTS[i % len(HEIGHTS)]
        corners = [(0.0, 0.0), (0.0, SIDE), (SIDE, SIDE), (SIDE, 0.0)]
        square = [[north + x, east + y, down] for x, y in corners]
        vehicles.append({"position_ned": square[0], "waypoints_ned": [*square[1:], square[0]]})
    reach = columns * SPACING + 200.0
    for axis in "xy":
        content["world"]["area"][f"{axis}_min"] = -reach
        content["world"]["area"][f"{axis}_max"] = reach
    content["name"] = f"{scenario}_{count}"
    content["fleets"]["pelicans"]["vehicles"] = vehicles
    return content


class Nothing:
    """Sums up nothing of a flight."""

    def init(self, world: Any, state: Any) -> tuple[()]:
        """Return no memory."""
        return ()

    def update(self, flight: Any, world: Any, state: Any, tick: Any) -> tuple[()]:
        """Return no memory."""
        return ()


class Took(NamedTuple):
    """Time that something took [s], by the clock and of the processor."""

    wall: float
    cpu: float


class Flown:
    """Worlds in flight, which are compiled and have flown one tick.

    Args:
        world: of each.
        worlds: how many.
        metrics: of the flight; None: nothing is summed up.

    Attributes:
        compiled: what it took to the end of the first tick.
        vehicles: in all worlds together.
    """

    def __init__(self, world: Any, worlds: int, metrics: Any = None):
        import numpy as np

        from qrsim.core.noise import Key
        from qrsim.simulation.many_worlds import Flight
        from qrsim.simulation.rollout import setup_of
        from qrsim.world.draws import keys_of

        wall, cpu = time.perf_counter(), time.process_time()
        setup, fixed, own = setup_of([world], metrics=metrics or Nothing())
        keys = keys_of(world, Key.roots(np.zeros(worlds, np.int64), np.arange(worlds)))
        count = sum(fleet.size for fleet in world.fleets)
        self.flight, self.tick, self.vehicles = Flight(setup, fixed, own, keys, count, 1), 0, worlds * count
        self.advance(1)
        self.compiled = Took(time.perf_counter() - wall, time.process_time() - cpu)

    def advance(self, ticks: int) -> Took:
        """Fly some ticks, to the end, and return the time that they took."""
        import numpy as np

        wall, cpu = time.perf_counter(), time.process_time()
        self.flight.advance(self.tick, ticks, ((), ()))
        np.asarray(self.flight.get(lambda carry: carry.wrong_tick))
        self.tick += ticks
        return Took(time.perf_counter() - wall, time.process_time() - cpu)

    def ticks_in(self, seconds: float) -> int:
        """Fly ten ticks, and return how many take so long [s] of wall time, a multiple of ten."""
        return max(10, round(10 * seconds / max(self.advance(10).wall, 1e-6)) // 10 * 10)

    def flying(self) -> int:
        """Return how many vehicles still fly."""
        import numpy as np

        codes = self.flight.get(lambda carry: [fleet.violation.code for fleet in carry.state.fleets])
        return int((np.concatenate(codes, axis=-1) == 0).sum())


def machine() -> dict[str, Any]:
    """Return what the numbers were measured on, and how busy it was."""
    return {
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "load_average": [round(load, 2) for load in os.getloadavg()],
        "os": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        **{name: version(name) for name in ("jax", "jaxlib", "qrsim")},
    }


def _cpu_model() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def publish(
    name: str,
    title: str,
    on: Mapping[str, Any],
    results: Sequence[Mapping[str, Any]],
    headings: Mapping[str, str],
    as_json: bool,
) -> None:
    """Print the results as a table or as JSON.

    Args:
        name: of the benchmark.
        title: what was measured, one line.
        on: ``machine()``, taken before the measurement: the load it shows is not the benchmark's own.
        results: rows; all have the same keys.
        headings: key -> heading of its column; keys that are not here are in the JSON only.
        as_json: which of the two.
    """
    if as_json:
        print(json.dumps({"benchmark": name, "machine": on, "results": list(results)}, indent=2, allow_nan=False))
        return
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE_HEAD, show_edge=False)
    for key, heading in headings.items():
        is_text = isinstance(results[0][key], str)
        table.add_column(Text(heading), justify="left" if is_text else "right", no_wrap=not is_text)
    for row in results:
        table.add_row(*(Text(_shown(row[key])) for key in headings))
    print(f"{title}\n")
    Console(width=None if Console().is_terminal else 120).print(table)
    loads = " ".join(f"{load:.2f}" for load in on["load_average"])
    print(f"\n{on['cpu']}, {on['cores']} cores, load average {loads} before (1, 5, 15 minutes), {on['os']}")
    print(f"Python {on['python']}, jax {on['jax']}, jaxlib {on['jaxlib']}, qrsim {on['qrsim']}\n")


def _shown(value: Any) -> str:
    """Return a number with three significant digits, or more where it has more before the point."""
    if value is None:
        return "-"
    if isinstance(value, str | int):
        return f"{value:,}" if isinstance(value, int) else value
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:,.{digits}f}"
