"""The one world of a server: its simulation, the stacks of its vehicles, and what they fly by; no sockets."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from qrsim.errors import UsageError
from qrsim.interface.arrays import quaternion_of
from qrsim.links.contracts import Order
from qrsim.links.mavlink.failures import Failures
from qrsim.links.mavlink.fleet import plan_parameters, start_parameters, start_rally, systems_of
from qrsim.links.mavlink.publishing import Publisher
from qrsim.links.mavlink.restarts import Restarts
from qrsim.links.mavlink.sight import StackSight
from qrsim.links.mavlink.simulated import SimParameters, SimWind
from qrsim.links.mavlink.stack.codes import Severity
from qrsim.links.mavlink.stack.contracts import NEEDED, Datum, Facts, Stack, Text
from qrsim.links.mavlink.stack.flight import Flight
from qrsim.links.mavlink.stack.geodesy import geoid_of
from qrsim.links.mavlink.system import System
from qrsim.links.shared.around import Around
from qrsim.links.shared.latches import Latches
from qrsim.links.shared.recording import Recording
from qrsim.models.site import Site
from qrsim.scenarios.scenario import Scenario
from qrsim.simulation.injections import targets_of
from qrsim.simulation.simulation import Simulation

# How often a receiver without a fix reports that [s], and the least GPS_FIX_TYPE of one.
NO_FIX_EVERY_S, LEAST_FIX = 0.2, 2
# A stack for a vehicle at a site.
MakeStack = Callable[[Facts, Site], Stack]


class FlownWorld:
    """A simulation whose vehicles are flown by their stacks, or go by their own guidance while those look on.

    Args:
        scenario: prepared (``fleet.prepared``).
        make_stack: makes the stack of a vehicle.
        seed: of the episode.
        first_system: MAVLink system id of the first vehicle.
        factor: simulated seconds per second of the wall clock.
        truth: whether vehicles may tell their true state.
        respawn: whether vehicles that have crashed are put back to where they began, by themselves.
        datum: what altitudes of messages are measured from.
        record: folder for a recording; None: it is not recorded.
        log: told one line of what clients are told.

    Raises:
        UsageError: no vehicle can be flown, or there are more than system ids.
        RunError: the recording cannot be written.

    Attributes:
        simulation: reset.
        recording: of it; None: it is not recorded.
        systems: of the vehicles that are flown or shown.
    """

    def __init__(
        self,
        scenario: Scenario,
        make_stack: MakeStack,
        *,
        seed: int = 0,
        first_system: int = 1,
        factor: float = 1.0,
        truth: bool = False,
        respawn: bool = False,
        datum: Datum = "sea",
        record: Path | None = None,
        log: Callable[[str], None] = lambda line: None,
    ):
        world, site = scenario.world(), scenario.site
        known = systems_of(world, first_system)
        self.simulation = Simulation(world, seed=seed, name=scenario.name, site=site)
        self.simulation.reset()
        self._truth, self._geoid = truth, geoid_of(site, datum)
        self._latches = Latches(world.fleets, self.simulation.dtype)
        self.systems: list[System] = []
        self._rows: list[int] = []
        unix, rally = scenario.spec.start_time.timestamp(), start_rally(scenario, world)
        planned = plan_parameters(scenario, world)
        for row, facts in known:
            stack = make_stack(replace(facts, datum=datum), site)
            stack.factor = factor
            if isinstance(stack, Flight):
                self._start_parameters(stack, row)
                for name, value in planned.get(row, {}).items():
                    stack.parameters.set(name, value)
                stack.rally = rally.get(row, ())
            if isinstance(stack, Flight) and any(map(targets_of, world.fleets)):
                stack.craft.injector = Failures(self.simulation, facts.name, facts.system).inject
            self.systems.append(System(stack, facts.name, facts.system, unix, log))
            self._rows.append(row)
        self._warm()
        made = None if record is None else Recording(record, scenario, self.simulation, self._latches)
        self.recording: Recording | None = made
        self._air = SimWind(self.simulation)
        for system in self.systems:
            if isinstance(system.stack, Flight) and system.stack.flavour.name == "ardupilot":
                system.booted = SimParameters(self.simulation, system.stack.craft, self._air).again
        self._sight = StackSight(self.simulation, self._geoid)
        around = Around(self.simulation, self._sight)
        for row, system in zip(self._rows, self.systems, strict=True):
            system.view.around, system.view.number, system.view.geoid = around, row, self._geoid
        self._publisher = Publisher(self.systems)
        self._busy = 0.0
        self._respawn = respawn
        self._restarts = self._fresh_restarts()
        self._command()

    def _start_parameters(self, stack: Flight, row: int) -> None:
        """Set the flight stack's parameters of the vehicle at ``row`` of the world to the failsafes of its scenario."""
        for fleet in self.simulation.world.fleets:
            rows = self.simulation.world.rows_of(fleet.name)
            if rows.start <= row < rows.stop:
                for name, value in start_parameters(fleet, row - rows.start).items():
                    stack.parameters.set(name, value)

    def _warm(self) -> None:
        """Compile all programs that a flight needs, restarts included, before the first tick."""
        self.simulation.advance(self._latches.actions())
        self.simulation.set_state(np.full_like(self.simulation.truth.state, np.nan))
        self.simulation.reset()

    def _fresh_restarts(self) -> Restarts:
        """Return a new ``Restarts`` object, in which no vehicle waits for a restart."""
        systems = list(zip(self._rows, self.systems, strict=True))
        return Restarts(self.simulation, self._latches, systems, self._respawn, self._put_back)

    def _put_back(self, row: int) -> None:
        """Note in the recording that the vehicle at ``row`` has been put back to its start."""
        if self.recording is not None:
            self.recording.restarted(row)

    def tick(self, wall: float) -> None:
        """Advance the world by one tick, run the flight stacks, and send all due messages; ``wall`` [s]:
        ``time.monotonic``.

        Args:
            wall: time of the wall clock [s], of ``time.monotonic``.
        """
        begin = time.perf_counter()
        self._restarts.look()
        self._air.tick()
        self._latches.advance(self.simulation)
        if self.recording is not None:
            self.recording.keep()
        self._command()
        unlinked = self.simulation.unlinked
        for system in self.systems:
            system.muted = system.name in unlinked
        self._publisher.publish(self.simulation.tick, wall)
        busy = (time.perf_counter() - begin) / self.simulation.world.time_step
        self._busy += 0.02 * (busy - self._busy)

    def reset(self, seed: int) -> None:
        """Start a new episode with a seed: vehicles at their starts, disarmed; parameters and plans stay."""
        if self.recording is not None:
            self.recording.end()
        self.simulation.reset(seed)
        if self.recording is not None:
            self.recording.begin()
        for system in self.systems:
            system.stack.reset()
            self._latches.clear(system.name)
            system.view.order = None
            system.booted()
        self._air.again()
        self._sight, self._restarts = StackSight(self.simulation, self._geoid), self._fresh_restarts()
        self._command()

    def _command(self) -> None:
        """Run every vehicle's flight stack on its present readings, and latch the order that it returns."""
        sight = self._sight
        seen = sight.see()
        load = int(min(1000.0, 1e3 * self._busy))
        true = self._true_states() if self._truth else None
        # A receiver without a fix says so.
        tells = self.simulation.tick % max(1, round(NO_FIX_EVERY_S / self.simulation.world.time_step)) == 0
        for row, system in zip(self._rows, self.systems, strict=True):
            view = system.view
            view.seen = seen[row]
            view.look(sight.values[row])
            view.fresh = sight.fresh[row] or (tells and seen[row].fix_type < LEAST_FIX)
            view.fix_time, view.load = sight.fix_time[row], load
            if true is not None:
                view.truth = tuple(true[row])
            order = system.stack.tick(seen[row])
            if order is not None and order is not view.order:
                self._fly(system, order)

    def _fly(self, system: System, order: Order) -> None:
        """Latch an order for its vehicle; an order that the controller cannot fly is reported to clients, and the last
        one holds."""
        try:
            # A set-point has no range of its own; the whole check, with its words, is for what cannot be flown.
            if not (order.kind in NEEDED and math.isfinite(sum(order.numbers))):
                self._latches.checked(order)
            self._latches.put(order)
        except UsageError as error:
            # What cannot be flown is not; the last order holds.
            system.tell_once(f"order {order.kind}", Text(Severity.ERROR, f"Not flown: {error}"))
            return
        system.view.order = order

    def _true_states(self) -> Sequence[Sequence[float]]:
        """Return for each vehicle its true quaternion, body rates, geodetic position, velocity, airspeed and specific
        force."""
        truth, site = self.simulation.truth, self.simulation.site
        latitude, longitude, height = site.ned_to_geodetic(truth.position_ned)
        altitude = height - self._geoid.undulation(truth.position_ned[:, 0], truth.position_ned[:, 1])
        velocity = truth.velocity_ned
        airspeed = np.linalg.norm(velocity - truth.wind_ned, axis=1)
        quaternion = quaternion_of(np.asarray(truth.attitude))
        columns = (
            quaternion,
            truth.rates_body,
            np.degrees(latitude)[:, None],
            np.degrees(longitude)[:, None],
            altitude[:, None],
            velocity,
            airspeed[:, None],
            truth.specific_force,
        )
        return np.concatenate(columns, axis=1, dtype=np.float64).tolist()
