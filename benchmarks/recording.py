"""What recording costs: a flight that is recorded over the same ticks alone, by turns, after both are compiled.

Wall time of the flight without start-up, summary and figure. The share of the flying thread is its processor time: the
rest of the writing is done by another thread.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import _common

DURATION_S, ROUNDS = 1200, 5
SCENARIOS = ("outdoor_patrol", "mavlink_field", "mixed_team")
HEADINGS = {
    "what": "scenario",
    "ticks_s": "ticks alone [s]",
    "recorded_s": "recorded [s]",
    "over_ticks": "recorded over ticks",
    "thread_over_ticks": "flying thread over ticks",
    "megabytes": "run folder [MB]",
}


def ticks_alone(scenario: Any) -> float:
    """Return the wall time of the ticks of a flight [s]."""
    import qrsim

    simulation = qrsim.Simulation(scenario.world("float32"), seed=0, name=scenario.name, site=scenario.site)
    simulation.reset()
    simulation.advance()
    begun = time.perf_counter()
    simulation.advance(ticks=scenario.ticks - 1)
    return time.perf_counter() - begun


def recorded(scenario: Any, folder: Path) -> tuple[float, float]:
    """Return the wall time of a recorded flight, and the processor time of its thread without start-up [s]."""
    from qrsim.runs import recorder

    begun = time.thread_time()
    pace = recorder.fly(scenario, folder, seed=0, precision="float32")
    return pace.wall_s, time.thread_time() - begun - pace.start_up_s


def measure(name: str, duration_s: float, rounds: int) -> dict[str, Any]:
    """Return the medians of one scenario."""
    import qrsim

    scenario = qrsim.load_scenario(name, [f"duration={duration_s}"], quiet=True)
    alone, walls, threads, size = list[float](), list[float](), list[float](), 0
    with tempfile.TemporaryDirectory() as parent:
        for number in range(rounds + 1):
            ticks, folder = ticks_alone(scenario), Path(parent) / str(number)
            wall, thread = recorded(scenario, folder)
            # The first round compiles.
            if number:
                alone.append(ticks)
                walls.append(wall)
                threads.append(thread)
            size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    base = statistics.median(alone)
    return {
        "what": name,
        "ticks_s": base,
        "recorded_s": statistics.median(walls),
        "over_ticks": statistics.median(walls) / base,
        "thread_over_ticks": statistics.median(threads) / base,
        "megabytes": size / 1e6,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    _common.without_cache()
    on = _common.machine()
    names, duration_s, rounds = (SCENARIOS[:1], 10, 1) if chosen.quick else (SCENARIOS, DURATION_S, ROUNDS)
    rows = [measure(name, duration_s, rounds) for name in names]
    _common.publish("recording", "Flights of 1 200 s, recorded and not", on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
