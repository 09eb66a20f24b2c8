"""What a step and a look cost in Python: time, and calls of functions of the package.

Steps of one world of five vehicles by way-points, and looks at one field. With ``--against SRC``, the folder ``src`` of
another version, both take turns in processes of their own, and the ratio of the times is printed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import _common

TURNS = 3
HEADINGS = {"call": "call", "us": "time [us]", "calls": "calls", "files": "files"}
AGAINST = {"against_us": "against [us]", "ratio": "ratio"}


def doors() -> dict[str, Callable[[], Any]]:
    """Return the measured calls by the expression that a user writes."""
    import qrsim

    sim = qrsim.load(_common.patrol(5), seed=1)
    sim.reset()
    goal = sim.truth.position_ned - [0.0, 0.0, 5.0]
    held: list[Any] = [None]

    def held_step() -> None:
        held[0] = sim.step()

    return {
        "step(sim.waypoint(goal))": lambda: sim.step(sim.waypoint(goal)),
        "step().gnss.position_ned": lambda: sim.step().gnss.position_ned,
        "truth.position_ned": lambda: sim.truth.position_ned,
        "reading = step()": held_step,
        "advance()": sim.advance,
    }


def calls_of(call: Callable[[], Any]) -> tuple[int, int]:
    """Return how many functions of the package a call calls, and in how many of its files they are."""
    found: list[str] = []

    def profile(frame: Any, event: str, argument: Any) -> None:
        if event == "call" and frame.f_globals.get("__name__", "").partition(".")[0] == "qrsim":
            found.append(frame.f_code.co_filename)

    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(None)
    return len(found), len(set(found))


def measured(calls: int, rounds: int) -> list[dict[str, Any]]:
    """Return a row for each call, the best of rounds of the mean of calls, in time of this process."""
    every, rows = doors(), []
    for _ in range(200):
        for call in every.values():
            call()
    for name, call in every.items():
        best = float("inf")
        for _ in range(rounds):
            begun = time.process_time()
            for _ in range(calls):
                call()
            best = min(best, (time.process_time() - begun) / calls)
        count, files = calls_of(call)
        rows.append({"call": name, "us": round(1e6 * best, 2), "calls": count, "files": files})
    return rows


def compared(source: str) -> list[dict[str, Any]]:
    """Return the rows of this version with the best times of both, which take turns."""
    own = str(Path(__file__).resolve().parent.parent / "src")
    found: dict[str, list[list[dict[str, Any]]]] = {own: [], source: []}
    for _ in range(TURNS):
        for folder, each in found.items():
            environment = {**os.environ, "PYTHONPATH": folder}
            done = subprocess.run(
                [sys.executable, __file__, "--json"], env=environment, capture_output=True, text=True, check=True
            )
            each.append(json.loads(done.stdout)["results"])
    rows = []
    for number, row in enumerate(found[own][0]):
        mine, theirs = (min(each[number]["us"] for each in found[folder]) for folder in (own, source))
        rows.append({**row, "us": mine, "against_us": theirs, "ratio": round(mine / theirs, 3)})
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments, against="the folder src of another version")
    on = _common.machine()
    if chosen.against:
        rows, headings = compared(chosen.against), HEADINGS | AGAINST
    else:
        rows, headings = measured(5, 1) if chosen.quick else measured(1000, 7), HEADINGS
    _common.publish("stepping", "Steps and looks of one world of five vehicles", on, rows, headings, chosen.json)


if __name__ == "__main__":
    main()
