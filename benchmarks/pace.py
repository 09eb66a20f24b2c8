"""Several controllers of one world in real time: late ticks, and how soon an order is flown."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import _common
import serve

HEADINGS = {
    "what": "what",
    "controllers": "controllers",
    "ticks": "ticks",
    "overruns_percent": "overruns [%]",
    "overruns_target": "target",
    "latency_median_ms": "latency: median [ms]",
    "latency_p99_ms": "99 % [ms]",
    "latency_target": "target",
    "missed": "missed",
}
PILOT = Path(__file__).resolve().parent / "_pilot.py"
# A tick of 20 ms, and what is allowed beside it.
MOST_LATENCY_MS = 25.0


def flown(controllers: int, seconds: float) -> dict[str, Any]:
    """Return the row of some controllers, each a process with a vehicle of its own, at 50 Hz in real time."""
    import numpy as np

    content = _common.patrol(controllers)
    names = [f"{fleet}_{i}" for fleet in content["fleets"] for i in range(controllers)]
    with serve.served(content, "--pace", "free", "--max-clients", str(controllers + 2)) as port:
        words = [[sys.executable, str(PILOT), str(port), name, str(seconds)] for name in names]
        pilots = [subprocess.Popen(each, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for each in words]
        for pilot in pilots:
            assert pilot.stdout is not None
            assert pilot.stdout.readline() == "ready\n"
        for pilot in pilots:
            assert pilot.stdin is not None
            pilot.stdin.write("\n")
            pilot.stdin.flush()
        found = [json.loads(pilot.communicate(timeout=60.0 + 4.0 * seconds)[0]) for pilot in pilots]
    pacing = max((each["pacing"] for each in found), key=lambda pacing: pacing["steps"])
    latency = np.concatenate([each["latency_ms"] for each in found])
    median, p99 = np.percentile(latency, [50, 99])
    return {
        "what": f"--pace free, 50 Hz for {seconds:g} s, a process for each vehicle",
        "controllers": controllers,
        "ticks": int(pacing["steps"]),
        "overruns_percent": round(100.0 * pacing.get("overruns", 0) / pacing["steps"], 3),
        "overruns_target": 1.0,
        "latency_median_ms": round(float(median), 2),
        "latency_p99_ms": round(float(p99), 2),
        "latency_target": MOST_LATENCY_MS if controllers <= 10 else None,
        "missed": sum(each["missed"] for each in found),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    results = [flown(2, 1.0)] if chosen.quick else [flown(10, 60.0), flown(30, 60.0)]
    _common.publish(
        "pace", "Several controllers of one world, in real time over loopback", on, results, HEADINGS, chosen.json
    )


if __name__ == "__main__":
    main()
