"""``qrsim autopilot px4``."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qrsim.apps import SECONDS, Duration, Repeated, with_duration
from qrsim.apps.autopilot.shared import Injecting, check, fresh_folder, recorded, report, say
from qrsim.errors import RunError, UsageError
from qrsim.links.pacing import FASTEST, SLOWEST

if TYPE_CHECKING:
    from qrsim.links.autopilot.px4_flight import Px4Flight
    from qrsim.scenarios.scenario import Scenario
    from qrsim.simulation.simulation import Simulation

# Beginnings of airframe names of PX4; none_iris is the airframe without a simulator.
ELSEWHERE = ("gz_", "sihsim_", "gazebo", "jmavsim", "none_")
FRAME_HZ, FASTEST_HZ = 250, 2000
LAST_PORT = 65_535


@dataclass(frozen=True)
class Px4:
    """Fly the multirotors of a scenario with PX4's SITL firmware, one instance for each, in lock-step.

    Start PX4 yourself, for vehicle i, from 0, in an empty folder: PX4_SIM_MODEL=none_iris BUILD/bin/px4 -i i -d
    BUILD/etc. Or let --px4 BUILD start and end them. Without --px4, --env prints the parameters that each PX4 needs.
    The vehicles stand on the ground until a ground station, a script or PX4's shell takes off. PX4 gets the readings of
    the fleet's IMU, magnetometer, barometer and GNSS receiver, including noise. docs/howto/px4.md has the details.
    This has not been tested with the firmware itself, only with a stand-in that follows PX4's sources.

    Example:
      qrsim autopilot px4 mavlink_field --duration 300
      qrsim autopilot px4 mavlink_field --px4 ~/PX4-Autopilot/build/px4_sitl_default
      qrsim autopilot px4 mixed_team --fleet hexas --env
    """

    scenario: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SCENARIO")] = "mavlink_field"
    """Name (see 'qrsim list') or YAML file."""
    fleet: Annotated[Repeated, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: all it can)")] = field(
        default_factory=list
    )
    """Fleet that PX4 flies; can be given several times. The others fly as in the scenario."""
    px4: Annotated[
        Path | None, tyro.conf.arg(name="px4", metavar="DIR", help_behavior_hint="(default: you start PX4)")
    ] = None
    """Build folder of PX4, such as PX4-Autopilot/build/px4_sitl_default: start a PX4 from it for each vehicle."""
    env: bool = False
    """Print the environment variables and the command of each PX4, and fly nothing."""
    param: Annotated[Repeated, tyro.conf.arg(metavar="NAME=VALUE")] = field(default_factory=list)
    """Parameter of PX4, for --px4 and --env, after those of qrsim; can be given several times."""
    port: Annotated[
        int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="(default: 4560 + --first-instance)")
    ] = None
    """TCP port of the first vehicle, for a start script of PX4 with other ports; each further vehicle is one higher."""
    first_instance: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Instance of the first vehicle's PX4 (-i); its MAV_SYS_ID is one more."""
    wait: Annotated[float, SECONDS] = 120.0
    """Time to wait for all PX4s to connect, and for the first answer of each."""
    realtime: float = 1.0
    """Simulated seconds per second of the wall clock, at most; 0: as fast as it goes."""
    truth: bool = False
    """Send the true state as well (HIL_STATE_QUATERNION), which PX4 only logs."""
    allow_remote: bool = False
    """Let PX4 connect from other machines. Only in a network that you trust."""
    model: Annotated[str, tyro.conf.arg(metavar="NAME")] = "x500"
    """Replacement for an identified quadrotor: hummingbird, x500 or crazyflie."""
    rate: Annotated[float, tyro.conf.arg(metavar="HZ")] = 250.0
    """Ticks of the simulation a second: 250 or a multiple of it up to 2000. PX4 gets 250 readings a second."""
    seed: int = 0
    """Seed of the episode."""
    duration: Duration = None
    """Simulated time, from the first reading that PX4 gets."""
    set: Annotated[Repeated, tyro.conf.arg(metavar="PATH=VALUE")] = field(default_factory=list)
    """Change one value of the scenario; can be given several times."""
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: runs/px4-SCENARIO-seedSEED-TIME)")
    ] = None
    """Run folder to write; must not exist."""
    every: Annotated[int, tyro.conf.arg(metavar="N")] = 5
    """Log every Nth tick; 5 means 50 a second at 250 Hz."""
    faults: Injecting = field(default_factory=Injecting)
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> None:
        """Run ``qrsim autopilot px4``: check the options, open the ports, start PX4 if asked, fly, and print a
        summary."""
        self._check()
        from qrsim.links.autopilot.px4_flight import Px4Flight, prepared
        from qrsim.links.autopilot.px4_link import EVERYWHERE, FIRST_PORT, LOOPBACK
        from qrsim.links.autopilot.px4_parameters import checked
        from qrsim.links.autopilot.px4_process import Build, started
        from qrsim.scenarios.scenario import load_scenario

        own = checked(self.param)
        build = None if self.px4 is None else Build(self.px4)
        overrides = with_duration(self.set, self.duration)
        scenario, fleets = prepared(load_scenario(self.scenario, overrides), tuple(self.fleet), self.model, self.rate)
        start_usec = round(scenario.spec.start_time.timestamp() * 1e6)
        port = FIRST_PORT + self.first_instance if self.port is None else self.port
        host = EVERYWHERE if self.allow_remote else LOOPBACK
        if self.env:
            self._print_environment(scenario, fleets, port, own, "BUILD" if build is None else str(build.folder))
            return
        scenario, injections = self.faults.applied(scenario)
        folder = fresh_folder(self.out, "px4", scenario.name, self.seed)
        logs = folder.with_name(f"{folder.name}-px4")

        def flown_by(simulation: Simulation) -> Px4Flight:
            """Return the flight of a simulation by PX4, and print the TCP port of each vehicle."""
            flight = Px4Flight(
                simulation,
                fleets,
                start_usec,
                port,
                self.first_instance,
                self.wait,
                self.realtime,
                self.truth,
                host,
                say,
            )
            if build is None:
                for link in flight.links:
                    say(f"{link.name} waits for PX4 instance {link.instance} on TCP {link.port}")
                if not all(each.is_iris for each in flight.fleets):
                    say("PX4's none_iris is another vehicle than these; start PX4 with what --env prints")
            else:
                flight.opened(lambda: started(build, flight, own, logs))
                say(f"PX4's logs: {logs}")
            return flight

        with recorded(self, folder, scenario, injections, flown_by) as (flight, pace):
            for link in flight.links:
                if link.oddities:
                    say(f"{link.name}: {link.oddities}")
            report(self, "PX4", folder, fleets, pace)
        if flight.lost:
            raise RunError(f"{len(flight.lost)} of {len(flight.links)} PX4s ended in flight: {', '.join(flight.lost)}")

    def _check(self) -> None:
        """Raise UsageError for options that are out of range or do not go together."""
        if not (math.isfinite(self.rate) and self.rate % FRAME_HZ == 0 and FRAME_HZ <= self.rate <= FASTEST_HZ):
            raise UsageError(f"--rate {self.rate:g}: expected {FRAME_HZ} Hz or a multiple of it, up to {FASTEST_HZ} Hz")
        if self.model.startswith(ELSEWHERE):
            raise UsageError(
                f"--model {self.model}: this airframe is flown inside PX4 or by Gazebo; PX4 runs as none_iris here, "
                "and --model is hummingbird, x500 or crazyflie"
            )
        check(self)
        if self.port is not None and not 1024 <= self.port <= LAST_PORT:
            raise UsageError(f"--port {self.port}: expected 1024 to {LAST_PORT}")
        if self.port is not None and self.px4 is not None:
            raise UsageError("--port: PX4 connects to 4560 + its instance when --px4 starts it; use --first-instance")
        if self.first_instance < 0:
            raise UsageError(f"--first-instance {self.first_instance}: expected an integer from 0")
        if not (math.isfinite(self.wait) and self.wait > 0):
            raise UsageError(f"--wait {self.wait:g}: expected a positive number of seconds")
        if not (self.realtime == 0.0 or SLOWEST <= self.realtime <= FASTEST):
            raise UsageError(
                f"--realtime {self.realtime:g}: expected {SLOWEST:g} to {FASTEST:g}, or 0 for as fast as it goes"
            )

    def _print_environment(
        self, scenario: Scenario, fleets: tuple[str, ...], port: int, own: dict[str, int | float], build: str
    ) -> None:
        """Print, for each vehicle, the shell commands that start its PX4; ``own``: the user's parameters, ``build``:
        PX4's folder."""
        from qrsim.links.autopilot.px4_flight import listed
        from qrsim.links.autopilot.px4_parameters import environment
        from qrsim.simulation.simulation import Simulation

        simulation = Simulation(scenario.world("float32"), seed=self.seed, name=scenario.name, site=scenario.site)
        simulation.reset()
        for i, (vehicle, found) in enumerate(listed(simulation, fleets, port, self.first_instance)):
            instance = self.first_instance + i
            print(f"# {vehicle}: instance {instance}, TCP {port + i}; a separate shell and empty folder")
            for name, value in environment(found | own).items():
                print(f"export {name}={value}")
            print(f"{shlex.quote(f'{build}/bin/px4')} -i {instance} -d {shlex.quote(f'{build}/etc')}\n")
