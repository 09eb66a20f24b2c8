"""200 flights with a random failure at a random time: what happened, and the worst one on the page.

    python examples/random_failures.py [FLIGHTS]

Change SCENARIO and FAILURES to those of your own vehicles.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import qrsim

SCENARIO, DURATION, SEED = "outdoor_patrol", 40.0, 0
# Name, the fault, and what of it every flight draws: smallest and largest value.
FAILURES: list[tuple[str, dict[str, Any], dict[str, tuple[float, float]]]] = [
    ("receiver off", {"sensor": "gnss", "kind": "off"}, {}),
    ("receiver drifts", {"sensor": "gnss", "kind": "drift", "field": "position_ned.x", "rate": 1.0},
     {"rate": (0.5, 3.0)}),
    ("barometer stuck", {"sensor": "barometer", "kind": "stuck"}, {}),
    ("magnetometer wrong", {"sensor": "magnetometer", "kind": "wrong", "field": "field_body.x", "bias": 10.0},
     {"bias": (-30.0, 30.0)}),
]  # fmt: skip


def scenario(fault: dict[str, Any], drawn: dict[str, tuple[float, float]]) -> dict[str, Any]:
    """Return the scenario with a fault that begins at a random time."""
    content = qrsim.load_scenario(SCENARIO).spec.model_dump(mode="json") | {"duration": DURATION}
    (name, fleet), *_ = content["fleets"].items()
    fleet["faults"] = [fault | {"start": 5.0}]
    ranges = {"start": (5.0, DURATION - 5.0)} | drawn
    content["ranges"] = [
        {"path": f"fleets.{name}.faults.0.{what}", "low": low, "high": high} for what, (low, high) in ranges.items()
    ]
    return content


def main(flights: int = 200) -> None:
    """Fly, print a table and record the worst flight."""
    each, worst = max(1, flights // len(FAILURES)), (-1.0, "", 0)
    print(f"{'failure':<20} {'flights':>7} {'vehicles lost':>13} {'largest tracking error, median [m]':>35}")
    for name, fault, drawn in FAILURES:
        flown = qrsim.rollout(scenario(fault, drawn), seeds=range(SEED, SEED + each))
        lost = flown.metrics["reason"] != 0
        error = np.where(lost, np.inf, flown.metrics["tracking_error_max_m"]).max(axis=1)
        print(f"{name:<20} {each:>7} {int(lost.sum()):>13} {np.median(error):>35.2f}")
        # Lost vehicles count first, then the largest error.
        score = lost.sum(axis=1) * 1e6 + np.where(np.isfinite(error), error, 0.0)
        if score.max() > worst[0]:
            worst = (float(score.max()), name, int(score.argmax()))
    _, name, number = worst
    fault, drawn = next((fault, drawn) for known, fault, drawn in FAILURES if known == name)
    folder = Path("runs") / f"{name.replace(' ', '_')}_{SEED + number}"
    # With the seed alone a run draws the same as that flight.
    qrsim.fly(qrsim.load_scenario(scenario(fault, drawn)), folder, seed=SEED + number, precision="float32")
    print(f"the worst: {name}, seed {SEED + number}; look at it with: qrsim view {folder}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
