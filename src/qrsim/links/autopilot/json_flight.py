"""A simulation whose multirotors are flown by ArduPilot over the JSON interface, with one instance for each vehicle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from typing import cast

from qrsim.errors import UsageError
from qrsim.links.autopilot import ardupilot, fleet
from qrsim.links.autopilot.lockstep import FlownFleet, LockstepFlight, chosen
from qrsim.links.autopilot.losses import Losses
from qrsim.links.autopilot.servo_link import PORT_STEP, ServoLink
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet

LARGEST_PORT = 65535
prepared = partial(fleet.prepared, who="ArduPilot", on_ground=True)


def motor_order(flown: Fleet) -> tuple[int, ...]:
    """Return the motor number (from 0) of each rotor in ArduPilot's frame X; raises UsageError for other frames.

    Raises:
        UsageError: there is no such frame, or its motors stand or turn otherwise.
    """
    order = fleet.motor_order(flown)
    if order is None:
        count = len(cast(Multirotor, flown.vehicle).rotors)
        raise UsageError(
            f"fleet '{flown.name}': its {count} rotors are no frame X of ArduPilot's, with 4, 6 or 8 arms, the "
            "one right of the nose turning counter-clockwise (of 8: clockwise), and neighbours the other way"
        )
    return order


def last_port(option: str, first: int, step: int, count: int, kind: str) -> None:
    """Raise UsageError, naming ``option``, if the last vehicle's port ``first + step * (count - 1)`` is too large;
    ``kind``: "UDP port" or so."""
    last = first + step * (count - 1)
    if last > LARGEST_PORT:
        raise UsageError(f"{option}: the last vehicle would have {kind} {last}, at most {LARGEST_PORT} is allowed")


class JsonFleet(FlownFleet):
    """The vehicles of a fleet and the ports of their autopilots."""

    def __init__(self, simulation: Simulation, flown: Fleet, links: Sequence[ServoLink], losses: Losses):
        super().__init__(simulation, flown, motor_order(flown), losses)
        self._links = links
        self.sight.look()
        self._start = self.sight.positions()

    def speeds(self, number: int) -> Sequence[float]:
        """Wait for ArduPilot's servo packet for vehicle ``number``; return its motor speeds as fractions of the
        maximum."""
        return ardupilot.speeds(self._links[number].wait().pulses, len(self.order))

    def answer(self) -> None:
        """Send each vehicle's ArduPilot the vehicle's present state."""
        _, sensed = self.sight.look()
        time = self.simulation.tick * self.simulation.world.time_step
        for link, seen, now, first in zip(self._links, sensed, self.sight.positions(), self._start, strict=True):
            away = [here - there for here, there in zip(now, first, strict=True)]
            link.answer(ardupilot.answer(time, seen, away))


class JsonFlight(LockstepFlight):
    """Flies a simulation by autopilots that come to its ports.

    Args:
        simulation: reset, at tick 0.
        fleets: names of those that are flown so; the others fly as ever.
        port: of the first vehicle, UDP on the loopback; each other ``PORT_STEP`` further on.
        wait: for the first packet of each, and for the restart of one that has become silent [s].
        say: told lines.
        lost: told a line when an autopilot does not come, or ends, whose vehicle's motors then stop; None: all end.

    Raises:
        UsageError: a fleet cannot be flown, or a port is taken.
    """

    def __init__(
        self,
        simulation: Simulation,
        fleets: Sequence[str],
        port: int,
        wait: float,
        say: Callable[[str], None] = lambda line: None,
        lost: Callable[[str], None] | None = None,
    ):
        super().__init__(simulation)
        flown = chosen(simulation, fleets)
        last_port(f"--port {port}", port, PORT_STEP, sum(each.size for each in flown), "UDP")
        self.links: list[ServoLink] = []

        def build() -> None:
            """Open a UDP port for every vehicle, and build the fleets."""
            for each in flown:
                motor_order(each)
                own = []
                for name in each.vehicle_names:
                    link = ServoLink(name, port + PORT_STEP * len(self.links), wait, say)
                    self.closing.enter_context(closing(link))
                    self.links.append(link)
                    own.append(link)
                self.fleets.append(JsonFleet(simulation, each, own, Losses(lost)))

        self.opened(build)
