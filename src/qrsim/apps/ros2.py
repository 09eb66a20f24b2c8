"""``qrsim ros2``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

import tyro

from qrsim.errors import UsageError
from qrsim.extras import require


@dataclass(frozen=True)
class Ros2:
    """Make a scenario a node of ROS 2, without a ROS installation: sensors, odometry, TF and /clock of every vehicle.

    Vehicles go by their scenario's guidance until a node flies them: by cmd_vel, setpoint_position/local,
    setpoint_velocity/cmd_vel or setpoint_attitude/attitude in the namespace of the vehicle's name. docs/ros2.md lists
    the topics.

    It speaks DDS, as the default middleware of ROS 2. Anybody in the network with the same domain can fly.

    Ctrl-C or SIGTERM ends it.

    Example:
      qrsim ros2
      qrsim ros2 my_scenario.yaml --domain 7 --realtime 2
      qrsim ros2 outdoor_patrol --truth --set world.wind.speed_20ft=6
    """

    scenario: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SCENARIO")] = "outdoor_patrol"
    """Name (see 'qrsim list') or YAML file."""
    domain: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: ROS_DOMAIN_ID, else 0)")] = (
        None
    )
    """Domain of DDS, 0 to 232."""
    realtime: Annotated[float, tyro.conf.arg(metavar="FACTOR")] = 1.0
    """Simulated seconds per second of the wall clock."""
    seed: int = 0
    """Seed of the episode."""
    set: Annotated[tyro.conf.UseAppendAction[list[str]], tyro.conf.arg(metavar="PATH=VALUE")] = field(
        default_factory=list
    )
    """Change one value of the scenario; can be given several times."""
    distro: Annotated[str, tyro.conf.arg(metavar="NAME")] = "jazzy"
    """Distribution of the other nodes: humble, iron, jazzy, kilted or lyrical."""
    truth: bool = False
    """Publish the true motion and wind too, below ground_truth/; without it there are estimates and readings only."""
    reliable: bool = False
    """Send lost readings of sensors again, for nodes that ask for reliable ones."""
    hold: Annotated[float, tyro.conf.arg(metavar="SECONDS")] = 0.5
    """After so long without a velocity or an attitude, a vehicle that was flown by them holds its place."""
    paused: bool = False
    """Begin standing, until 'resume' or 'step N' comes by /qrsim/control."""
    duration: Annotated[
        float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: until Ctrl-C)")
    ] = None
    """End after so much simulated time."""

    def run(self) -> None:
        """Check, compile, serve."""
        self._check()
        domain = self._domain()
        require("ros2", "'qrsim ros2'")
        from qrsim.links.printing import Log
        from qrsim.links.ros2.participant import checked_domain
        from qrsim.links.ros2.server import Options, Server
        from qrsim.links.ros2.typestore import Types
        from qrsim.scenarios.scenario import load_scenario
        from qrsim.simulation.simulation import Simulation

        types = Types(self.distro)
        checked_domain(domain)
        scenario = load_scenario(self.scenario, self.set)
        simulation = Simulation(scenario.world(), seed=self.seed, name=scenario.name, site=scenario.site)
        log = Log()
        options = Options(domain, self.realtime, self.truth, self.reliable, self.hold, self.paused)
        try:
            server = Server(simulation, types, options, log.say)
            spaces = server.messages.namespaces
            log.say(f"qrsim ros2: {len(spaces)} vehicles, {', '.join(spaces[:5])}{', ...' if len(spaces) > 5 else ''}")
            log.say(f"domain {domain}, {len(server.messages.topics)} topics, {self.distro}; docs/ros2.md")
            try:
                server.serve(math.inf if self.duration is None else self.duration - 1e-9)
            finally:
                report = server.report()
                if report.steps:
                    log.say(
                        f"{report.simulated:.1f} s simulated in {report.wall:.1f} s; {report.overruns} of "
                        f"{report.steps} ticks late, the worst by {report.worst_delay:.3f} s"
                    )
        finally:
            log.close()

    def _check(self) -> None:
        if not (math.isfinite(self.realtime) and 1e-3 <= self.realtime <= 1e3):
            raise UsageError(f"--realtime {self.realtime:g}: expected 0.001 to 1000")
        if not 0 <= self.seed < 2**63:
            raise UsageError(f"--seed {self.seed}: expected an integer from 0 to 2**63 - 1")
        if not (math.isfinite(self.hold) and 0.01 <= self.hold <= 3600.0):
            raise UsageError(f"--hold {self.hold:g}: expected 0.01 to 3600 seconds")
        if self.duration is not None and not (math.isfinite(self.duration) and self.duration > 0.0):
            raise UsageError(f"--duration {self.duration:g}: expected more than 0 seconds")

    def _domain(self) -> int:
        """Return the domain that is given, or that of the environment."""
        import os

        if self.domain is not None:
            return self.domain
        given = os.environ.get("ROS_DOMAIN_ID") or "0"
        if not given.isdecimal():
            raise UsageError(f"ROS_DOMAIN_ID is '{given[:60]}': expected a number")
        return int(given)
