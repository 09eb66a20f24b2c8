"""``qrsim mavlink``."""

from __future__ import annotations

import ipaddress
import math
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qrsim.apps import Repeated, check_seed
from qrsim.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from qrsim.links.mavlink.ports import Ports
    from qrsim.links.mavlink.world import FlownWorld

FLAVOURS = ("px4", "ardupilot")
ORIGINS = ("start", "site")
DATUMS = ("sea", "ellipsoid")
LAST_SYSTEM = 240


@dataclass(frozen=True)
class Mavlink:
    """Make every vehicle of a scenario a MAVLink system, for QGroundControl, MAVSDK, pymavlink and MAVProxy.

    The vehicles start disarmed on the ground, below their scenario positions, with modes, parameters, missions and
    failsafes like those of PX4. Vehicle i (from 0) is system i + 1. It sends to UDP port 14540 + i for programs (from
    the tenth vehicle on to 14549) and to 14550 for a ground station. For scripts see docs/howto/mavlink_scripts.md, for
    the supported messages docs/reference/mavlink.md.

    Anyone who can send to its ports can fly. Connections are neither encrypted nor authenticated, so only programs on
    this machine can connect unless --allow-remote is given.

    Ctrl-C or SIGTERM ends it.

    Example:
      qrsim mavlink
      qrsim mavlink my_scenario.yaml --realtime 5
      qrsim mavlink outdoor_patrol --tcp --set world.wind.speed_20ft=6
      qrsim mavlink --injectable all
    """

    scenario: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SCENARIO")] = "mavlink_field"
    """Name (see 'qrsim list') or YAML file."""
    realtime: Annotated[float, tyro.conf.arg(metavar="FACTOR")] = 1.0
    """Simulated seconds per second of the wall clock."""
    seed: int = 0
    """Seed of the episode."""
    set: Annotated[Repeated, tyro.conf.arg(metavar="PATH=VALUE")] = field(default_factory=list)
    """Change one value of the scenario; can be given several times."""
    flavour: Annotated[str, tyro.conf.arg(metavar="px4|ardupilot")] = "px4"
    """Autopilot whose mode numbers are used."""
    local_origin: Annotated[str, tyro.conf.arg(metavar="start|site")] = "start"
    """Origin of each vehicle's local frame (LOCAL_POSITION_NED, SET_POSITION_TARGET_LOCAL_NED, ...): its position when
    its estimator started, or the site of the scenario, which all vehicles share."""
    datum: Annotated[str, tyro.conf.arg(metavar="sea|ellipsoid")] = "sea"
    """Zero of altitudes in messages: mean sea level (EGM96), or the WGS-84 ellipsoid, as in qrsim 0.2.
    GPS_RAW_INT.alt_ellipsoid is always above the ellipsoid."""
    first_sysid: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """MAVLink system id of the first vehicle; the last one is 240."""
    own_ports: bool = False
    """Also give vehicles from the tenth on separate ports: 14540 + i."""
    tcp: bool = False
    """Also listen on TCP port 5760; a client there receives all vehicles."""
    gcs: Annotated[str, tyro.conf.arg(metavar="HOST")] = "127.0.0.1"
    """Address of the ground station: vehicles send to its UDP port 14550."""
    allow_remote: bool = False
    """Let other machines connect: listen on all addresses of this machine."""
    stream_time: Annotated[str, tyro.conf.arg(metavar="wall|sim")] = "wall"
    """Clock for the limit of 100 messages of a kind per second, when the world runs faster than the wall clock."""
    lockstep: bool = False
    """Begin when every vehicle has a set-point. Then wait at every tick, for at most 1 s of wall time, until each
    vehicle has a set-point newer than the last ATTITUDE sent to its client, so that runs are bit-identical."""
    respawn: bool = False
    """Return a crashed or collided vehicle to its start after 3 s; without this option, a reboot does so."""
    injectable: Annotated[Repeated, tyro.conf.arg(metavar="NAME|all")] = field(default_factory=list)
    """Let clients inject failures (INJECT_FAILURE, with SYS_FAILURE_EN set to 1): name of a sensor, rotors,
    battery, radio, body, or all; can be given several times."""
    record: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: not recorded)")] = None
    """Folder for recordings, one folder for each flight; 'qrsim replay' flies its run again."""
    truth: bool = False
    """Let clients request HIL_STATE_QUATERNION, the true state; without it they get only estimates and readings."""

    def run(self) -> None:
        """Run ``qrsim mavlink``: check the scenario, compile it, and serve MAVLink until interrupted."""
        self._check()
        ground = self._address()
        from qrsim.files.interruptions import run_until_signal
        from qrsim.links.mavlink.fleet import prepared
        from qrsim.links.mavlink.ports import EVERYWHERE, HERE, opened
        from qrsim.links.mavlink.server import Server, Wire
        from qrsim.links.mavlink.stack.stacks import stack_of
        from qrsim.links.mavlink.world import FlownWorld
        from qrsim.links.printing import Log
        from qrsim.scenarios.scenario import load_scenario

        log = Log()
        say = log.say
        world = FlownWorld(
            prepared(load_scenario(self.scenario, self.set), self.injectable),
            stack_of(self.flavour, self.local_origin),  # type: ignore[arg-type]
            seed=self.seed,
            first_system=self.first_sysid,
            factor=self.realtime,
            truth=self.truth,
            respawn=self.respawn,
            datum=self.datum,  # type: ignore[arg-type]
            record=self.record,
            log=say,
        )
        ports = opened(len(world.systems), EVERYWHERE if self.allow_remote else HERE, self.tcp, self.own_ports)
        server = Server(world, ports, Wire(self.realtime, HERE, ground, self.stream_time == "sim", self.lockstep), say)
        self._describe(world, ports, ground, say)
        try:
            run_until_signal(server.serve())
        finally:
            ports.close()
            if world.recording is not None:
                world.recording.close()
                say(f"recorded: {world.recording.folder}")
            report = server.report()
            if report.steps:
                say(
                    f"{report.simulated:.1f} s simulated in {report.wall:.1f} s; {report.overruns} of {report.steps} "
                    f"ticks late, the worst by {report.worst_delay:.3f} s"
                )
            log.close()

    def _check(self) -> None:
        """Raise UsageError for options that are out of range or do not go together."""
        if not (math.isfinite(self.realtime) and 1e-3 <= self.realtime <= 1e3):
            raise UsageError(f"--realtime {self.realtime:g}: expected 0.001 to 1000")
        check_seed(self.seed)
        if not 1 <= self.first_sysid <= LAST_SYSTEM:
            raise UsageError(f"--first-sysid {self.first_sysid}: expected 1 to {LAST_SYSTEM}")
        for name, value, allowed in (
            ("--flavour", self.flavour, FLAVOURS),
            ("--local-origin", self.local_origin, ORIGINS),
            ("--datum", self.datum, DATUMS),
            ("--stream-time", self.stream_time, ("wall", "sim")),
        ):
            if value not in allowed:
                raise UsageError(f"{name} {value}: expected {' or '.join(allowed)}{did_you_mean(value, allowed)}")

    def _address(self) -> str:
        """Return the IP address to which messages for the ground station go first."""
        try:
            address = socket.gethostbyname(self.gcs)
        except (OSError, UnicodeError):
            raise UsageError(f"--gcs {self.gcs}: no such host") from None
        if ipaddress.ip_address(address).is_loopback:
            if self.allow_remote:
                _warn()
            return address
        if not self.allow_remote:
            raise UsageError(
                f"--gcs {self.gcs}: it is another machine, which could fly; if that is meant, give --allow-remote too"
            )
        _warn()
        return address

    def _describe(self, world: FlownWorld, ports: Ports, ground: str, say: Callable[[str], None]) -> None:
        """Print the vehicles' system ids, and the UDP and TCP ports on which they can be reached."""
        from qrsim.links.mavlink.ports import GROUND, GROUND_PEER, ONBOARD, TCP

        systems = world.systems
        last = len(systems) - 1
        if ports.block:
            first = f"UDP {ONBOARD} and {GROUND} on" + (f", TCP {TCP}" if ports.tcp else "")
            say(f"{first}: taken, by another qrsim mavlink for example; these are ports of block {ports.block}")
            if self.first_sysid == 1:
                say("a ground station that shows the other vehicles too needs other system ids: --first-sysid")
        say(f"qrsim mavlink: {len(systems)} vehicles, systems {systems[0].number} to {systems[-1].number}")
        peers = f"{ports.peers[0]}" if not last else f"{ports.peers[0]} to {ports.peers[-1]}"
        say(f"programs: UDP {peers}, from {ports.onboard} to {ports.onboard + last}")
        say(f"ground station: UDP {ground}:{GROUND_PEER}, from {ports.ground} to {ports.ground + last}")
        if ports.tcp:
            say(f"TCP: {ports.tcp}")
        others = world.simulation.size - len(systems)
        if others:
            say(f"{others} more of the scenario cannot be flown, and are no systems")


def _warn() -> None:
    """Warn that other machines can command the vehicles."""
    print(
        "warning: every machine that can reach this one can fly these vehicles; nothing is encrypted", file=sys.stderr
    )
