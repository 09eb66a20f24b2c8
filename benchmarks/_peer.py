"""How a peer is timed; runs in the peer's own environment, so it needs the standard library only."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable


def timed(advance: Callable[[], int], step_s: float, seconds: float, finite: Callable[[], bool]) -> None:
    """Warm up, say "ready", wait for a line, fly for some time, and print what was done as JSON.

    Args:
        advance: flies and returns how many vehicle-steps that were.
        step_s: simulated seconds per step.
        seconds: of wall time to fly for.
        finite: whether what was flown still has finite states.
    """
    advance()
    print("ready", flush=True)
    sys.stdin.readline()
    steps, wall, cpu = 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - wall < seconds:
        steps += advance()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(json.dumps({"steps": steps, "wall": wall, "cpu": cpu, "step_s": step_s, "finite": finite()}), flush=True)
