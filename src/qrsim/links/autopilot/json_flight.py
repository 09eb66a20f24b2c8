"""A simulation whose multirotors are flown by ArduPilot, each by one of its own, over the JSON interface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing

import numpy as np

from qrsim.errors import ScenarioError, UsageError
from qrsim.links.autopilot import ardupilot
from qrsim.links.autopilot.fleet import refitted
from qrsim.links.autopilot.flight import flown_history
from qrsim.links.autopilot.losses import Losses
from qrsim.links.autopilot.sensing import FleetSight
from qrsim.links.autopilot.servo_link import PORT_STEP, ServoLink
from qrsim.links.shared.grounding import put_down, standing
from qrsim.models.vehicles.multirotor.commands import MotorCommand
from qrsim.models.vehicles.multirotor.vehicle import Multirotor
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.simulation.history import History
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet, Piloted

# Arms of a vehicle may stand so far from those of ArduPilot's frame [deg].
NEAR_DEG = 12.0
LARGEST_PORT = 65535


def prepared(scenario: Scenario, fleets: tuple[str, ...], model: str, rate: float) -> tuple[Scenario, tuple[str, ...]]:
    """Return a scenario whose fleets ArduPilot can fly, at rest on the ground, and the names of these.

    Args:
        scenario: of the user.
        fleets: names; none: all with vehicles of rotors.
        model: what identified quadrotors become.
        rate: ticks a second [Hz].

    Raises:
        UsageError: an unknown fleet, or one without rotors; a scenario that cannot be so.
    """
    content, flown = refitted(scenario, fleets, model, rate, "ArduPilot")
    for name in flown:
        standing(content["fleets"][name], True)
    try:
        put_down(content, load_scenario(content, quiet=True).world(), flown)
        return load_scenario(content, quiet=True), flown
    except ScenarioError as error:
        raise UsageError(f"on the ground, flown at {rate:g} Hz by ArduPilot: {error}") from None


def motor_order(fleet: Fleet) -> tuple[int, ...]:
    """Return for each rotor of the vehicles the number of its motor in ArduPilot's frame X, from 0.

    Raises:
        UsageError: there is no such frame, or its motors stand or turn otherwise.
    """
    rotors = fleet.vehicle.rotors if isinstance(fleet.vehicle, Multirotor) else ()
    frame = ardupilot.FRAMES.get(len(rotors), ())
    order = []
    for rotor in rotors:
        bearing = np.degrees(np.arctan2(rotor.position[1], rotor.position[0]))
        order += [
            number
            for number, (arm, turn) in enumerate(frame)
            if abs((bearing - arm + 180.0) % 360.0 - 180.0) < NEAR_DEG and turn == rotor.direction
        ]
    if not frame or sorted(order) != list(range(len(frame))):
        raise UsageError(
            f"fleet '{fleet.name}': its {len(rotors)} rotors are no frame X of ArduPilot's, with 4, 6 or 8 arms, the "
            "one right of the nose turning counter-clockwise (of 8: clockwise), and neighbours the other way"
        )
    return tuple(order)


class JsonFleet:
    """The vehicles of a fleet and the ports of their autopilots."""

    def __init__(self, simulation: Simulation, fleet: Fleet, links: Sequence[ServoLink], losses: Losses):
        number = [each.name for each in simulation.world.fleets].index(fleet.name)
        self.fleet, self.links, self._losses = fleet, links, losses
        self._order = list(motor_order(fleet))
        self._command = MotorCommand.of_count(len(self._order))
        self._dtype = simulation.dtype
        self._sight = FleetSight(simulation, number)
        self._sight.look()
        self._start = [place[:] for place in self._sight.positions()]

    def wait(self) -> Piloted:
        """Return what the motors are to do, once all autopilots have sent it; without one they stand still."""
        table = np.zeros((len(self.links), len(self._order)), self._dtype)
        for i in self._losses.left(len(self.links)):
            with self._losses.watched(i):
                table[i] = ardupilot.speeds(self.links[i].wait().pulses, len(self._order))
        return Piloted(self._command(*np.ascontiguousarray(table[:, self._order].T)))

    def answer(self, time: float) -> None:
        """Tell all what they sense now, at a time [s]."""
        _, sensed = self._sight.look()
        for link, seen, now, first in zip(self.links, sensed, self._sight.positions(), self._start, strict=True):
            away = [here - there for here, there in zip(now, first, strict=True)]
            link.answer(ardupilot.answer(time, seen, away))


class JsonFlight:
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
        self.simulation = simulation
        world = simulation.world
        chosen = [next(fleet for fleet in world.fleets if fleet.name == name) for name in fleets]
        last = port + PORT_STEP * (sum(fleet.size for fleet in chosen) - 1)
        if last > LARGEST_PORT:
            raise UsageError(
                f"--port {port}: the last vehicle would have UDP {last}, at most {LARGEST_PORT} is allowed"
            )
        self._dt = world.time_step
        self.links: list[ServoLink] = []
        self._fleets = []
        with ExitStack() as close:
            for fleet in chosen:
                motor_order(fleet)
                own = []
                for name in fleet.vehicle_names:
                    link = ServoLink(name, port + PORT_STEP * len(self.links), wait, say)
                    close.enter_context(closing(link))
                    self.links.append(link)
                    own.append(link)
                self._fleets.append(JsonFleet(simulation, fleet, own, Losses(lost)))
            self._close = close.pop_all()

    def advance(self, ticks: int = 1) -> None:
        """Fly so many ticks, each when all autopilots have sent what to do in it; raises RunError if one is gone."""
        for _ in range(ticks):
            simulation = self.simulation
            simulation.advance({fleet.fleet.name: fleet.wait() for fleet in self._fleets})
            for fleet in self._fleets:
                fleet.answer(simulation.tick * self._dt)

    def record(self, ticks: int, capacity: int = 50) -> History:
        """Fly so many ticks and return their states; ``capacity`` is not needed here."""
        return flown_history(self.simulation, self.advance, ticks)

    def close(self) -> None:
        """Close all ports."""
        self._close.close()

    def __enter__(self) -> JsonFlight:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
