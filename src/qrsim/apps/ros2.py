"""``qrsim ros2``."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qrsim.apps import OPTIONAL_SECONDS, SECONDS, Repeated, check_seed
from qrsim.errors import UsageError, did_you_mean
from qrsim.extras import require

if TYPE_CHECKING:
    from qrsim.links.ros2.apis.flown import Flown
    from qrsim.links.ros2.node import Node
    from qrsim.links.ros2.typestore import Types
    from qrsim.scenarios.scenario import Scenario
    from qrsim.simulation.simulation import Simulation

# As links/ros2/server.py has them, which takes long to load.
PACES = ("free", "fast", "barrier")
TRANSPORTS = ("dds", "zenoh")
APIS = ("qrsim", "mavros", "px4")
# How long a router of zenoh has to answer before it is said that it does not.
ROUTER_S = 2.0


@dataclass(frozen=True)
class Ros2:
    """Run a scenario as a ROS 2 node, without a ROS installation: sensors, odometry, TF and /clock of every vehicle.

    Vehicles follow their scenario's guidance until a node flies them through cmd_vel, setpoint_position/local,
    setpoint_velocity/cmd_vel or setpoint_attitude/attitude in the namespace of the vehicle's name.
    docs/reference/ros2_topics.md lists the topics.

    It uses DDS, like the default middleware of ROS 2, or zenoh. Anyone in the network with the same domain can fly.

    Ctrl-C or SIGTERM ends it.

    Example:
      qrsim ros2
      qrsim ros2 my_scenario.yaml --domain 7 --realtime 2
      qrsim ros2 --transport zenoh
      qrsim ros2 outdoor_patrol --truth --set world.wind.speed_20ft=6
      qrsim ros2 --injectable gnss --injectable battery
    """

    scenario: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SCENARIO")] = "outdoor_patrol"
    """Name (see 'qrsim list') or YAML file."""
    domain: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: ROS_DOMAIN_ID, else 0)")] = (
        None
    )
    """Domain of DDS, 0 to 232."""
    transport: Annotated[str, tyro.conf.arg(metavar="dds|zenoh")] = "dds"
    """Transport of the messages: dds for most middlewares of ROS 2, zenoh for rmw_zenoh."""
    router: Annotated[str, tyro.conf.arg(metavar="ENDPOINT")] = "tcp/localhost:7447"
    """Address of rmw_zenohd, with --transport zenoh."""
    api: Annotated[str, tyro.conf.arg(metavar="qrsim|mavros|px4")] = "qrsim"
    """Interface for nodes. qrsim: set-points only; mavros: its topics and services; px4: the topics of PX4's uXRCE-DDS
    bridge. With the last two, vehicles start on the ground, with PX4's arming, modes and failsafes."""
    namespaces: Annotated[
        str | None, tyro.conf.arg(metavar="PATTERN", help_behavior_hint="(default: see docs/howto/ros2_apis.md)")
    ] = None
    """Namespaces of --api mavros and px4, with {name}, {i} from 0 or {n} from 1, such as uav{n}."""
    realtime: Annotated[float, tyro.conf.arg(metavar="FACTOR")] = 1.0
    """Simulated seconds per second of the wall clock."""
    pace: Annotated[str, tyro.conf.arg(metavar="free|fast|barrier")] = "free"
    """free: by the wall clock; fast: as fast as it computes; barrier: each tick waits for a command for every vehicle
    that a node flies by velocities or attitudes."""
    rate: Annotated[float, tyro.conf.arg(metavar="HZ")] = 50.0
    """Largest rate of estimates, TF and truth; sensors have their own rates."""
    seed: int = 0
    """Seed of the episode."""
    set: Annotated[Repeated, tyro.conf.arg(metavar="PATH=VALUE")] = field(default_factory=list)
    """Change one value of the scenario; can be given several times."""
    distro: Annotated[str, tyro.conf.arg(metavar="NAME")] = "jazzy"
    """Distribution of the other nodes: humble, iron, jazzy, kilted or lyrical."""
    truth: bool = False
    """Also publish the true motion and wind, below ground_truth/; without it there are only estimates and readings."""
    reliable: bool = False
    """Publish sensors with reliable QoS, for nodes that require it."""
    hold: Annotated[float, SECONDS] = 0.5
    """Time without a velocity or an attitude until a vehicle flown by them holds its position."""
    injectable: Annotated[Repeated, tyro.conf.arg(metavar="NAME|all")] = field(default_factory=list)
    """Let nodes inject faults by /qrsim/control: name of a sensor, rotors, battery, radio, body, or all; can be
    given several times."""
    record: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: not recorded)")] = None
    """Folder for recordings: a folder for this flight, in it a run folder for each reset. 'qrsim replay' flies a run
    again."""
    paused: bool = False
    """Begin paused, until 'resume' or 'step N' arrives on /qrsim/control."""
    duration: Annotated[float | None, OPTIONAL_SECONDS, tyro.conf.arg(help_behavior_hint="(default: until Ctrl-C)")] = (
        None
    )
    """End after this simulated time."""

    def run(self) -> None:
        """Run ``qrsim ros2``: check the scenario, compile it, and serve ROS 2 until interrupted or --duration has
        passed."""
        self._check()
        domain = self._domain()
        require("ros2", "'qrsim ros2'")
        if self.transport == "zenoh":
            require("zenoh", "--transport zenoh")
        from qrsim.links.printing import Log
        from qrsim.links.ros2.participant import checked_domain
        from qrsim.links.ros2.server import Options, Server
        from qrsim.links.shared.injectable import with_injectable
        from qrsim.links.shared.recording import Recording
        from qrsim.scenarios.scenario import load_scenario

        checked_domain(domain)
        scenario = with_injectable(load_scenario(self.scenario, self.set), self.injectable)
        log = Log()
        options = Options(self.realtime, self.truth, self.hold, self.paused, self.rate, self.pace)
        try:
            types, simulation, flown = self._world(scenario, log.say)
            record = None if self.record is None else partial(Recording, self.record, scenario, simulation)
            server = Server(simulation, types, options, log.say, self._node(types, domain, log.say), flown, record)
            spaces = server.messages.namespaces
            log.say(f"qrsim ros2: {len(spaces)} vehicles, {', '.join(spaces[:5])}{', ...' if len(spaces) > 5 else ''}")
            carrier = f"zenoh by {self.router}" if self.transport == "zenoh" else "dds"
            count = len(server.messages.topics) + (0 if flown is None else len(flown.topics))
            if flown is not None:
                log.say(f"{self.api}: {', '.join(flown.spaces[:5])}{', ...' if len(flown.spaces) > 5 else ''}")
            log.say(f"domain {domain}, {count} topics, {self.distro}, {carrier}; docs/reference/ros2_topics.md")
            try:
                server.serve(math.inf if self.duration is None else self.duration - 1e-9)
            finally:
                if server.recording is not None:
                    server.recording.close()
                    log.say(f"recorded: {server.recording.folder}")
                report = server.report()
                if report.steps:
                    log.say(
                        f"{report.simulated:.1f} s simulated in {report.wall:.1f} s; {report.overruns} of "
                        f"{report.steps} ticks late, the worst by {report.worst_delay:.3f} s"
                    )
        finally:
            log.close()

    def _world(self, scenario: Scenario, say: Callable[[str], None]) -> tuple[Types, Simulation, Flown | None]:
        """Return the ROS message types, the simulation, and the vehicles flown by flight stacks, or None with --api
        qrsim."""
        from qrsim.links.ros2.typestore import Types

        if self.api == "qrsim":
            from qrsim.simulation.simulation import Simulation

            types = Types(self.distro)
            return types, Simulation(scenario.world(), seed=self.seed, name=scenario.name, site=scenario.site), None
        from qrsim.links.mavlink.fleet import prepared
        from qrsim.links.mavlink.stack.stacks import stack_of
        from qrsim.links.mavlink.world import FlownWorld
        from qrsim.links.ros2.apis.flown import PACKAGES, Flown

        types = Types(self.distro, PACKAGES[self.api])
        world = FlownWorld(
            prepared(scenario), stack_of("px4"), seed=self.seed, factor=self.realtime, log=say, record=self.record
        )
        return types, world.simulation, Flown(types, world, self.api, self.namespaces, self.rate)  # type: ignore[arg-type]

    def _node(self, types: Types, domain: int, say: Callable[[str], None]) -> Node:
        """Return the ROS node of the chosen transport, zenoh or DDS."""
        if self.transport == "zenoh":
            from qrsim.links.ros2.zenoh_node import ZenohNode

            node = ZenohNode(types, domain, resend=self.reliable, router=self.router)
            if not node.has_router(ROUTER_S):
                say(f"no zenoh router answers at {self.router} (rmw_zenohd); no node receives messages until one does")
            return node
        from qrsim.links.ros2.participant import Participant

        return Participant(types, domain, resend=self.reliable)

    def _check(self) -> None:
        """Raise UsageError for options that are out of range or do not go together."""
        if not (math.isfinite(self.realtime) and 1e-3 <= self.realtime <= 1e3):
            raise UsageError(f"--realtime {self.realtime:g}: expected 0.001 to 1000")
        if self.transport not in TRANSPORTS:
            near = did_you_mean(self.transport, TRANSPORTS)
            raise UsageError(f"--transport {self.transport}: expected {' or '.join(TRANSPORTS)}{near}")
        if self.api not in APIS:
            raise UsageError(f"--api {self.api}: expected {', '.join(APIS)}{did_you_mean(self.api, APIS)}")
        if self.api != "qrsim" and self.pace != "free":
            raise UsageError(f"--pace {self.pace}: --api {self.api} has a flight stack, which goes by --pace free")
        if self.api == "qrsim" and self.namespaces is not None:
            raise UsageError(f"--namespaces {self.namespaces}: is for --api mavros and --api px4")
        if not re.fullmatch(r"(tcp|tls|quic|udp|ws)/\S+:\d{1,5}(#\S*)?", self.router):
            raise UsageError(f"--router {self.router}: expected an endpoint of zenoh, such as tcp/localhost:7447")
        if self.pace not in PACES:
            raise UsageError(f"--pace {self.pace}: expected {', '.join(PACES)}{did_you_mean(self.pace, PACES)}")
        if self.pace != "free" and self.realtime != 1.0:
            raise UsageError(f"--realtime {self.realtime:g}: only --pace free goes by the wall clock, not {self.pace}")
        if not (math.isfinite(self.rate) and 0.1 <= self.rate <= 1000.0):
            raise UsageError(f"--rate {self.rate:g}: expected 0.1 to 1000 Hz")
        check_seed(self.seed)
        if not (math.isfinite(self.hold) and 0.01 <= self.hold <= 3600.0):
            raise UsageError(f"--hold {self.hold:g}: expected 0.01 to 3600 seconds")
        if self.duration is not None and not (math.isfinite(self.duration) and self.duration > 0.0):
            raise UsageError(f"--duration {self.duration:g}: expected more than 0 seconds")

    def _domain(self) -> int:
        """Return the ROS domain number of --domain, else that of the variable ROS_DOMAIN_ID."""
        import os

        if self.domain is not None:
            return self.domain
        given = os.environ.get("ROS_DOMAIN_ID") or "0"
        if not given.isdecimal():
            raise UsageError(f"ROS_DOMAIN_ID is '{given[:60]}': expected a number")
        return int(given)
