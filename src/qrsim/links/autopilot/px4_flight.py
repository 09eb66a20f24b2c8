"""A simulation whose multirotors are flown by PX4's SITL firmware in lock-step, with one process for each vehicle."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from typing import cast

from qrsim.errors import RunError, UsageError
from qrsim.links.autopilot import fleet
from qrsim.links.autopilot.json_flight import last_port
from qrsim.links.autopilot.lockstep import FlownFleet, LockstepFlight, chosen
from qrsim.links.autopilot.losses import Losses
from qrsim.links.autopilot.px4_feed import Px4Feed, time_usec
from qrsim.links.autopilot.px4_link import LOOPBACK, Px4Link
from qrsim.links.autopilot.px4_parameters import MOST_MOTORS, Number, parameters
from qrsim.links.pacing import Pacer
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet, Piloted

# Of HIL_SENSOR, whatever the rate of the world [Hz].
FRAME_HZ = 250.0
# A MAV_SYS_ID, which is one more than the instance, is at most 255.
LAST_INSTANCE = 254
prepared = partial(fleet.prepared, who="PX4", on_ground=True, inertial_rate=FRAME_HZ)


def motor_order(flown: Fleet) -> tuple[int, ...]:
    """Return for each rotor the number (from 0) of its motor in PX4's parameters CA_ROTORn.

    Four rotors in an X have the order of PX4's own quadrotors; all others have the order of the vehicle's rotors, which
    PX4 learns from the parameters of its geometry.

    Raises:
        UsageError: more rotors than PX4 has motors.
    """
    rotors = cast(Multirotor, flown.vehicle).rotors
    if len(rotors) > MOST_MOTORS:
        raise UsageError(f"fleet '{flown.name}': {len(rotors)} rotors, and PX4 has at most {MOST_MOTORS} motors")
    order = fleet.motor_order(flown, fleet.CORNER_DEG) if len(rotors) == 4 else None
    return order or tuple(range(len(rotors)))


class Px4Fleet(FlownFleet):
    """The vehicles of a fleet and the ports of their PX4s."""

    # At rest the truth does not change, and PX4 takes 100 equal readings for a sensor that has failed.
    fed_with_truth = False

    def __init__(
        self,
        simulation: Simulation,
        flown: Fleet,
        links: Sequence[Px4Link],
        losses: Losses,
        start_usec: int,
        truth: bool,
    ):
        super().__init__(simulation, flown, motor_order(flown), losses)
        self.links = links
        self._feed = Px4Feed(simulation, flown, self.sight, start_usec, truth)
        self._stride = round(1.0 / (FRAME_HZ * simulation.world.time_step))
        self._begin = 0.0
        self._answers: list[bool] = []
        self._held: Piloted | None = None

    @property
    def is_iris(self) -> bool:
        """Whether the rotors have the positions and directions of PX4's airframe none_iris."""
        return len(self.order) == 4 and fleet.motor_order(self.fleet, fleet.CORNER_DEG) is not None

    def parameters(self) -> list[dict[str, Number]]:
        """Return the PX4 parameters (name -> value) of each vehicle of the fleet."""
        return [parameters(self.fleet, self.order, self.sight, number) for number in range(self.fleet.size)]

    def connect(self, until: float | None) -> None:
        """Wait until every vehicle's PX4 is connected, at most until ``until`` of ``time.perf_counter`` [s]; None: as
        long as a lost one may be replaced.

        Args:
            until: time of ``time.perf_counter`` [s]; None: as long as a restart may take.
        """
        for i in self.losses.left(self.fleet.size):
            with self.losses.watched(i):
                self.links[i].connect(self.links[i].reconnects_until if until is None else until)

    def tell(self) -> None:
        """Send sensor readings to each vehicle's PX4, in the ticks in which a frame is due."""
        if self.simulation.tick % self._stride:
            return
        self._held = None
        self.connect(None)
        number = self.simulation.tick // self._stride
        frames, self._answers = self._feed.frames(number)
        for i in self.losses.left(self.fleet.size):
            self.links[i].send(frames[i], time_usec(number))
        self._begin = time.perf_counter()

    def speeds(self, number: int) -> Sequence[float]:
        """Return the motor speeds of vehicle ``number``, 0 to 1, after waiting for its PX4 to answer the last frame."""
        self.links[number].settle(self._begin, self._answers[number])
        return self.links[number].speeds(len(self.order))

    def piloted(self) -> Piloted:
        """Return the fleet's motor command from its PX4s; it holds until the next sensor frame."""
        if self._held is None:
            self._held = super().piloted()
        return self._held


def listed(
    simulation: Simulation, fleets: Sequence[str], port: int, first_instance: int
) -> list[tuple[str, dict[str, Number]]]:
    """Return each vehicle's name and PX4 parameters without opening a port; arguments as of ``Px4Flight``."""
    flown = chosen(simulation, fleets)
    _check_last(port, first_instance, sum(each.size for each in flown))
    found: list[tuple[str, dict[str, Number]]] = []
    for each in flown:
        own = Px4Fleet(simulation, each, (), Losses(None), 0, False)
        found += zip(each.vehicle_names, own.parameters(), strict=True)
    return found


def _check_last(port: int, first_instance: int, count: int) -> None:
    """Raise UsageError if the last of ``count`` vehicles would get a port or PX4 instance above the largest allowed."""
    last = first_instance + count - 1
    if last > LAST_INSTANCE:
        raise UsageError(
            f"--first-instance {first_instance}: the last vehicle would have PX4 instance {last}, at most "
            f"{LAST_INSTANCE} is allowed"
        )
    last_port(f"--port {port}", port, 1, count, "TCP")


class Px4Flight(LockstepFlight):
    """Flies a simulation by PX4s that connect to its ports.

    The end of one PX4 ends the flight of its vehicle only, whose motors stop.

    Args:
        simulation: reset, at tick 0, with 250 ticks a second or a multiple of that.
        fleets: names of those that are flown so; the others fly as ever.
        start_usec: when the scenario starts [us since 1970, UTC].
        port: TCP, of the first vehicle; each other one further on.
        first_instance: of PX4 (-i), for the first vehicle.
        wait: for all to connect, and for the first answer of each [s].
        realtime: simulated seconds per second of the wall clock at most; 0: as fast as it goes.
        truth: whether the true state is sent as well.
        host: address that is listened on.
        say: told lines.

    Raises:
        UsageError: a fleet cannot be flown, or a port is taken.

    Attributes:
        links: of all vehicles that are flown so.
    """

    def __init__(
        self,
        simulation: Simulation,
        fleets: Sequence[str],
        start_usec: int,
        port: int,
        first_instance: int = 0,
        wait: float = 120.0,
        realtime: float = 0.0,
        truth: bool = False,
        host: str = LOOPBACK,
        say: Callable[[str], None] = lambda line: None,
    ):
        super().__init__(simulation)
        flown = chosen(simulation, fleets)
        count = sum(each.size for each in flown)
        _check_last(port, first_instance, count)
        self.links: list[Px4Link] = []
        self._wait, self._pacer = wait, Pacer(realtime, simulation.time)
        self._begun = False

        # The only vehicle of a flight ends it by its own words.
        lost = say if count > 1 else None

        def build() -> None:
            """Open a TCP port for every vehicle, and build the fleets."""
            for each in flown:
                own = []
                for name in each.vehicle_names:
                    number = len(self.links)
                    link = Px4Link(name, first_instance + number, port + number, host, wait, say)
                    self.closing.enter_context(closing(link))
                    self.links.append(link)
                    own.append(link)
                self.fleets.append(Px4Fleet(simulation, each, own, Losses(lost), start_usec, truth))

        self.opened(build)

    def parameters(self) -> list[dict[str, Number]]:
        """Return the PX4 parameters (name -> value) of each vehicle of all fleets."""
        return [found for fleet in self.fleets for found in fleet.parameters()]

    def _begin(self) -> None:
        """Wait for all PX4s to connect; raises RunError if none does in time."""
        self._begun, until = True, time.perf_counter() + self._wait
        while not any(link.comes() for link in self.links):
            if time.perf_counter() > until:
                more = f"; further vehicles up to -i {self.links[-1].instance}" if len(self.links) > 1 else ""
                raise RunError(f"{self.links[0].name}: {self.links[0].nobody()}{more}")
            time.sleep(0.005)
        for each in self.fleets:
            each.connect(until)

    @property
    def lost(self) -> list[str]:
        """Return the names of the vehicles whose PX4 has ended."""
        return [
            name
            for fleet in self.fleets
            for number, name in enumerate(fleet.fleet.vehicle_names)
            if number not in fleet.losses.left(fleet.fleet.size)
        ]

    def advance(self, ticks: int = 1) -> None:
        """Fly ``ticks`` ticks in lock-step with all PX4s; raises RunError once none is left."""
        for _ in range(ticks):
            if not self._begun:
                self._begin()
            super().advance()
            if len(self.lost) == len(self.links):
                raise RunError("no PX4 is left to fly a vehicle")
            pause = self._pacer.wait_s(self.simulation.time)
            if pause > 0.0:
                time.sleep(pause)
