"""``qrsim serve``."""

from __future__ import annotations

import ipaddress
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qrsim.apps import SECONDS, Repeated, check_seed
from qrsim.errors import RunError, UsageError, did_you_mean, nearest, os_error_as
from qrsim.extras import require
from qrsim.files import Content

if TYPE_CHECKING:
    from qrsim.links.reference.roles import Options
    from qrsim.scenarios.scenario import Scenario
    from qrsim.view.live import LiveView


@dataclass(frozen=True)
class Serve:
    """Let a program in any language fly a live simulation over TCP.

    Speaks the protocol of the reference simulator, with extensions; its clients work unchanged. For clients in Python
    and C++ see docs/howto/tcp_client.md, for the protocol docs/reference/tcp_protocol.md. Clients choose a task by its
    name: any of 'qrsim list', those of the reference simulator, or SCENARIO. One client at a time controls the
    simulation, others can watch it. With --pace barrier or free all clients share one world of SCENARIO: each claims
    vehicles and flies them.

    Anyone who can connect can control the simulation. Connections are neither encrypted nor authenticated, so only
    programs on this machine can connect unless --allow-remote is given.

    Ctrl-C or SIGTERM ends the server.

    Example:
      qrsim serve
      qrsim serve keep_spot --realtime 1 --view
      qrsim serve my_scenario.yaml --sessions --record runs/served
      qrsim serve cats_and_mouse/1A --pace free
      qrsim serve keep_spot --injectable gnss --injectable battery
    """

    scenario: Annotated[
        tyro.conf.Positional[str | None], tyro.conf.arg(metavar="SCENARIO", help_behavior_hint="(default: none)")
    ] = None
    """Name or YAML file of a scenario that clients can select by its names, or by an empty name; names of the reference
    simulator are accepted too."""
    host: str = "127.0.0.1"
    """Address to listen on."""
    port: int = 10000
    """Port to listen on; 0: any free port."""
    allow_remote: bool = False
    """Let other machines connect, if --host is not a local-only address."""
    sessions: bool = False
    """Give every client its own session and world."""
    realtime: Annotated[
        float | None, tyro.conf.arg(metavar="FACTOR", help_behavior_hint="(default: as fast as clients ask)")
    ] = None
    """Simulated seconds per second of the wall clock; 1 by default with --pace free."""
    pace: Annotated[str, tyro.conf.arg(metavar="owner|barrier|free")] = "owner"
    """What advances the world: the steps of its client ('owner'); all clients with claimed vehicles together
    ('barrier'); or the wall clock, from the first claim on ('free')."""
    on_silence: Annotated[str, tyro.conf.arg(metavar="hold|return|stop")] = "hold"
    """Action of a claimed vehicle without its controller: hold its position, return to above its start, or stop its
    motors."""
    hold: Annotated[float, SECONDS] = 0.5
    """Time without a command until a claimed vehicle takes this action; 0: never, it keeps its last command."""
    timeout: Annotated[float, SECONDS, tyro.conf.arg(help_behavior_hint="(default: no limit)")] = 0.0
    """Wall-clock time that a barrier waits for a client before the world continues without it."""
    seed: int = 0
    """Seed of the first episode; with --episodes new, later episodes have the following seeds."""
    episodes: Annotated[str, tyro.conf.arg(metavar="new|same")] = "new"
    """Each start of a task (INIT, RESET) is another episode ('new') or the first one again ('same'). The seeds are
    printed."""
    idle_timeout: Annotated[float, SECONDS] = 1800.0
    """End the session of a client that has sent no request for this time; 0: never."""
    set: Annotated[Repeated, tyro.conf.arg(metavar="PATH=VALUE")] = field(default_factory=list)
    """Change one value of SCENARIO; can be given several times."""
    injectable: Annotated[Repeated, tyro.conf.arg(metavar="NAME|all")] = field(default_factory=list)
    """Let clients inject faults: name of a sensor of SCENARIO, rotors, battery, radio, body, or all; can be
    given several times."""
    allow_inject: bool = False
    """Let the clients of a shared world change its wind."""
    allow_quit: bool = False
    """Let clients end the server."""
    max_clients: Annotated[int, tyro.conf.arg(metavar="N")] = 32
    """Largest number of simultaneous connections."""
    record: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: not recorded)")] = None
    """Folder for recordings: one folder for each session, in it a run folder for each start of its task."""
    view: bool = False
    """Show the simulation in three dimensions on a page for a browser; its address is printed. Not with --sessions."""
    view_port: Annotated[int, tyro.conf.arg(metavar="PORT")] = 8080
    """Port of the page; if it is in use, the next free one."""
    view_host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address of this machine that the page listens on. If it is not 127.0.0.1, the printed address has a token, which
    is needed to view and control the page; nothing is encrypted."""

    def run(self) -> None:
        """Run ``qrsim serve``: check the scenarios, compile them, and serve until interrupted or told to quit."""
        options = self._options()
        scenario = self._scenario()
        import asyncio

        from qrsim.links.printing import Log
        from qrsim.links.reference.server import Server
        from qrsim.links.reference.tasks import Tasks

        tasks = Tasks(scenario, self.scenario, self.injectable)
        if scenario is not None and options.pace == "owner":
            _prepare(tasks, options)

        log = Log()

        def ready(host: str, port: int) -> None:
            """Print the server's address and that of its 3-D page."""
            log.say(f"qrsim serves on {host}:{port}")
            if options.view is not None:
                if options.pace == "owner":
                    options.view.wait_for(f"a client that connects to {host}:{port} and starts a task")
                log.say(f"page: {options.view.address}")

        async def serve() -> None:
            """Run the server until it is stopped."""
            await Server(options, tasks, log.say).serve(ready)

        try:
            asyncio.run(serve())
        finally:
            if options.view is not None:
                options.view.close()
            log.close()

    def _options(self) -> Options:
        """Return the server's options from the command line; raises UsageError for values out of range."""
        from qrsim.links.pacing import checked_factor
        from qrsim.links.reference.roles import Options
        from qrsim.links.reference.seeds import EPISODES

        if not 0 <= self.port <= 65535:
            raise UsageError(f"--port {self.port}: expected 0 to 65535")
        check_seed(self.seed)
        if self.episodes not in EPISODES:
            near = did_you_mean(self.episodes, EPISODES)
            raise UsageError(f"--episodes {self.episodes}: expected {' or '.join(EPISODES)}{near}")
        if self.max_clients < 1:
            raise UsageError(f"--max-clients {self.max_clients}: expected a positive number")
        if self.realtime is not None and not (math.isfinite(self.realtime) and self.realtime > 0.0):
            raise UsageError(f"--realtime {self.realtime:g}: expected a positive number")
        if not (math.isfinite(self.idle_timeout) and self.idle_timeout >= 0.0):
            raise UsageError(f"--idle-timeout {self.idle_timeout:g}: expected a number of seconds, or 0 for never")
        shared = self._shared()
        self._check_host()
        if self.record is not None:
            with os_error_as(RunError, f"--record {self.record}"):
                self.record.mkdir(parents=True, exist_ok=True)
        own = 1.0 if self.pace == "free" else 0.0
        return Options(
            self.host,
            self.port,
            checked_factor(self.realtime or own),
            self.allow_quit,
            self.max_clients,
            self.record,
            self.sessions,
            self.seed,
            self.episodes,
            self.idle_timeout,
            self._page(),
            allow_inject=self.allow_inject,
            **shared,
        )

    def _shared(self) -> Content:
        """Return the options of a world that all clients share, as keyword arguments of ``Options``."""
        from qrsim.links.contracts import PACES
        from qrsim.links.shared.plant import checked_silence

        if self.pace not in PACES:
            near = did_you_mean(self.pace, PACES)
            raise UsageError(f"--pace {self.pace}: expected {', '.join(PACES[:-1])} or {PACES[-1]}{near}")
        silence = checked_silence(self.on_silence, self.hold, "--on-silence")
        if not (math.isfinite(self.timeout) and self.timeout >= 0.0):
            raise UsageError(f"--timeout {self.timeout:g}: expected a number of seconds, or 0 for no limit")
        if self.pace == "owner":
            if self.allow_inject:
                raise UsageError("--allow-inject: it is for --pace barrier and free; a session's wind is its client's")
            return {}
        if self.scenario is None:
            raise UsageError(f"--pace {self.pace}: name the SCENARIO that the clients share")
        if self.sessions:
            raise UsageError(f"--pace {self.pace}: its clients share one world, and with --sessions each has its own")
        if self.timeout and self.pace != "barrier":
            raise UsageError("--timeout: it is for --pace barrier; --hold says what becomes of silent controllers")
        return {"pace": self.pace, "silence": silence, "barrier_timeout": self.timeout}

    def _page(self) -> LiveView | None:
        """Return the 3-D page of the simulation; None without --view."""
        if not self.view:
            return None
        if self.sessions:
            raise UsageError("--view: it shows one simulation, and with --sessions there are several")
        require("view", "--view")
        from qrsim.view.live import LiveView

        return LiveView(self.view_port, host=self.view_host)

    def _check_host(self) -> None:
        """Raise UsageError for a host that other machines can reach, unless --allow-remote is given; then warn."""
        if self.host == "localhost":
            return
        try:
            if ipaddress.ip_address(self.host).is_loopback:
                return
        except ValueError:
            pass  # a name
        if not self.allow_remote:
            raise UsageError(
                f"--host {self.host}: other machines could connect and control the simulation; if that is meant, "
                "give --allow-remote too"
            )
        print(
            f"warning: every machine that can reach {self.host} can control this simulation; nothing is encrypted",
            file=sys.stderr,
        )

    def _scenario(self) -> Scenario | None:
        """Return the scenario to serve; None if none is named, unless another option needs one (UsageError)."""
        if self.scenario is None:
            if self.set:
                raise UsageError("--set: there is no SCENARIO to change")
            from qrsim.links.shared.injectable import PARTS

            for name in self.injectable:
                if name not in PARTS:
                    raise UsageError(f"--injectable {name}: a SCENARIO with that sensor is needed; give one, or all")
            return None
        from qrsim.links.reference.tasks import REFERENCE_TASKS, ours
        from qrsim.scenarios.scenario import load_scenario

        meant = nearest(self.scenario, REFERENCE_TASKS) if self.scenario.startswith("Task") else None
        if meant not in (None, self.scenario) and not Path(self.scenario).exists():
            raise UsageError(f"no scenario is called '{self.scenario}'; did you mean '{meant}'?")
        return load_scenario(ours(self.scenario), self.set)


def _prepare(tasks: object, options: Options) -> None:
    """Compile the operator's scenario in advance, so that the first client does not wait."""
    from qrsim.links.reference.protocol.framing import LARGEST_FOR_REFERENCE_CLIENT
    from qrsim.links.reference.readout import largest_fleet, state_size
    from qrsim.links.reference.seeds import Seeds
    from qrsim.links.reference.session import Session, SessionOptions
    from qrsim.links.reference.tasks import Tasks

    assert isinstance(tasks, Tasks)
    session = Session(0, SessionOptions(tasks.offboard(""), Seeds(options.seed), realtime=1.0))
    session.begin()
    session.end()
    size, limit = session.simulation.size, LARGEST_FOR_REFERENCE_CLIENT
    if state_size(size) > limit:
        print(
            f"warning: the STATE of this fleet of {size} is {state_size(size)} bytes; clients of the reference "
            f"simulator take {limit}, that is {largest_fleet(limit)} vehicles",
            file=sys.stderr,
        )
