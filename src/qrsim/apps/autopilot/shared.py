"""Parts of the commands of all autopilots: checks, the recording, the summary."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import tyro

from qrsim.apps import Repeated, check_seed
from qrsim.errors import UsageError, did_you_mean
from qrsim.extras import require
from qrsim.view.flight import NOW, OFF, replay, shown, stay

if TYPE_CHECKING:
    from qrsim.links.autopilot.lockstep import LockstepFlight
    from qrsim.runs.recorder import Pace
    from qrsim.scenarios.scenario import Scenario
    from qrsim.simulation.injections import Injection
    from qrsim.simulation.simulation import Simulation

MODELS = ("hummingbird", "x500", "crazyflie")
SLOWEST_HZ, FASTEST_HZ = 200.0, 2000.0
Flown = TypeVar("Flown", bound="LockstepFlight")


# Options of a command: seed, duration, every, model, out, json and those of Injecting.
Options = Any


@dataclass(frozen=True)
class Injecting:
    """Faults in flight, and the page on which they are injected."""

    inject: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Faults and changes of the weather to inject, as 'qrsim run --inject' takes them."""
    injectable: Annotated[Repeated, tyro.conf.arg(metavar="NAME|all")] = field(default_factory=list)
    """Let faults be injected on the page of --view: name of a sensor, rotors, battery, radio, body, or all; can be
    given several times."""
    view: bool = False
    """Show the flight in three dimensions on a page for a browser; its address is printed. The page sets the speed, at
    first that of the wall clock. Afterwards it is a replay of the run."""
    view_port: Annotated[int, tyro.conf.arg(metavar="PORT")] = 8080
    """Port of the page; if it is in use, the next free one."""
    view_host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address of this machine that the page listens on. If it is not 127.0.0.1, the printed address has a token, which
    is needed to view and control the page; nothing is encrypted."""

    def check(self) -> None:
        """Raise UsageError for options about injections that do not fit together."""
        if self.injectable and not self.view:
            raise UsageError("--injectable: faults are injected on the page; add --view, or inject a file (--inject)")
        if self.view:
            require("view", "--view")

    def applied(self, scenario: Scenario) -> tuple[Scenario, tuple[Injection, ...]]:
        """Return the scenario with the parts of an injection file declared injectable, and the file's requests.

        Raises:
            UsageError: a part that no fleet has, or a file that cannot be read or injected.
        """
        from qrsim.links.shared.injectable import with_injectable
        from qrsim.scenarios.injection_file import read_injections

        scenario = with_injectable(scenario, self.injectable)
        return (scenario, ()) if self.inject is None else read_injections(scenario, self.inject)


def say(line: str) -> None:
    """Print a line to standard error."""
    print(line, file=sys.stderr, flush=True)


def check(options: Options) -> None:
    """Raise UsageError for an option out of range, of those that all autopilots have."""
    check_seed(options.seed)
    if options.every < 1:
        raise UsageError(f"--every {options.every}: expected an integer from 1")
    if options.model not in MODELS:
        raise UsageError(
            f"--model {options.model}: expected {' or '.join(MODELS)}{did_you_mean(options.model, MODELS)}"
        )
    options.faults.check()


def check_rate(rate: float) -> None:
    """Raise UsageError for a rate [Hz] out of range."""
    if not (math.isfinite(rate) and SLOWEST_HZ <= rate <= FASTEST_HZ):
        raise UsageError(f"--rate {rate:g}: expected {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz")


@contextmanager
def recorded(
    options: Options,
    folder: Path,
    scenario: Scenario,
    injections: tuple[Injection, ...],
    flown_by: Callable[[Simulation], Flown],
) -> Iterator[tuple[Flown, Pace]]:
    """In the context, use a finished flight of ``flown_by`` and its pace; after it, keep the 3-D page open.

    Args:
        options: of the command.
        folder: the run folder to write.
        scenario: to fly.
        injections: requests that are made in flight.
        flown_by: opens the flight of a simulation.
    """
    from qrsim.runs.recorder import fly

    flights: list[Flown] = []

    def opened(simulation: Simulation) -> Flown:
        """Return the flight of a simulation, and note that it has to be closed after the run."""
        flights.append(flown_by(simulation))
        return flights[0]

    streams = ("truth", "measurements", "commands", "wind") if options.every > 1 else ()
    every = dict.fromkeys(streams, options.every)
    faults: Injecting = options.faults
    with shown(NOW if faults.view else OFF, faults.view_port, faults.view_host) as page:
        try:
            pace = fly(
                scenario,
                folder,
                seed=options.seed,
                precision="float32",
                flown_by=opened,
                every=every,
                view=page,
                injections=injections,
            )
        finally:
            for flight in flights:
                flight.close()
        if page is not None:
            replay(page, folder)
        yield flights[0], pace
        if page is not None:
            stay(page)


def report(options: Options, who: str, folder: Path, fleets: tuple[str, ...], pace: Pace) -> None:
    """Print the summary of a flight by an autopilot (``who``), as text or JSON."""
    from qrsim.runs import open_run
    from qrsim.runs.separation import smallest_separation
    from qrsim.runs.summary import summarise

    recorded = open_run(folder)
    nearest = smallest_separation(recorded)
    stopped = {event.vehicle: event.message for event in recorded.events if event.kind in ("crashed", "collision")}
    rows: list[dict[str, object]] = [
        {
            "vehicle": row.vehicle,
            "distance_m": row.distance_m,
            "tracking_rms_m": row.tracking_error_rms_m,
            "waypoints": row.waypoints,
            "stopped": stopped.get(row.vehicle),
        }
        for row in summarise(recorded)
    ]
    if options.json:
        result = {"run": str(folder), "fleets": fleets, "simulated_s": pace.simulated_s, "wall_s": pace.wall_s}
        separation = None if nearest is None else nearest.to_json()
        print(json.dumps(result | {"separation": separation, "vehicles": rows}, indent=2))
        return
    print(f"{recorded.info.scenario}, seed {options.seed}, flown by {who}: {', '.join(fleets)}")
    for row in rows:
        ends = f"; {row['stopped']}" if row["stopped"] else ""
        print(
            f"{row['vehicle']}: {row['distance_m']:.1f} m flown, {row['tracking_rms_m']:.2f} m RMS from its legs, "
            f"{row['waypoints']} waypoints{ends}"
        )
    if nearest is not None:
        print(nearest.text)
    print(f"{pace.simulated_s:g} s flown in {pace.wall_s:.2f} s ({pace.real_time_factor:.1f} times real time)")
    print(f"run folder: {folder}")


def fresh_folder(out: Path | None, who: str, name: str, seed: int) -> Path:
    """Return the run folder to write: ``out``, or a new one named after autopilot (``who``), scenario and seed; raises
    UsageError if it exists."""
    from datetime import datetime

    folder = out or Path("runs") / f"{who}-{name}-seed{seed}-{datetime.now().strftime('%Y%m%d-%H%M%S')}"
    if folder.exists():
        raise UsageError(f"run folder {folder} exists and is never overwritten; choose another --out")
    return folder
