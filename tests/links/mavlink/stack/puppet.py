"""A point that does what a flight stack orders, to fly stacks without a simulation at thousands of ticks a second."""

from __future__ import annotations

import math
from dataclasses import replace

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.codes import MissionState, PlanKind, PlanResult
from qrsim.links.mavlink.stack.contracts import NAN, Ack, Command, Event, Facts, Item, Seen, Text
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.models.scene.zone import Zone
from qrsim.models.site import Site

DT = 0.02
# Zurich, whose scale is: one degree of latitude is 111.2 km, one of longitude 75.4 km (WGS-84).
# 488 m above the sea: the geoid is 47.22 m above the ellipsoid there.
SITE = Site.from_degrees(47.397742, 8.545594, 488.0 + 47.21997)
NORTH_DEG, EAST_DEG = 1.0 / 111_180.0, 1.0 / 75_441.0


def command(id: int, *params: float, frame: int = 0) -> Command:
    """Return a command whose further parameters are not set."""
    numbers = [*map(float, params), *[NAN] * (7 - len(params))]
    return Command(id, tuple(numbers), frame)  # type: ignore[arg-type]


def place(north: float, east: float) -> tuple[int, int]:
    """Return x and y of an item, so many metres from the site's origin."""
    return round((47.397742 + north * NORTH_DEG) * 1e7), round((8.545594 + east * EAST_DEG) * 1e7)


def item(seq: int, id: int, north: float = 0.0, east: float = 0.0, up: float = NAN, **more) -> Item:
    """Return an item at a place [m] in the frame of integers relative to home."""
    x, y = (0, 0) if north == 0.0 == east else place(north, east)
    numbers = more.pop("params", (0.0, 0.0, NAN, NAN))
    return Item(seq, more.pop("frame", 6), id, tuple(map(float, numbers)), more.pop("x", x), more.pop("y", y), up)


def polygon_zones(corners: tuple) -> tuple[Zone, ...]:
    """Return the zones of an area that is one polygon; none without corners."""
    return (Zone(True, (corners,)),) if corners else ()


class Puppet:
    """A vehicle that stands at first, and what its stack has said and told.

    Attributes:
        order: the last one.
        highest, farthest: how high it was [m], and how fast along the ground [m/s].
    """

    def __init__(
        self,
        flavour: str = "px4",
        factor: float = 1.0,
        fence: tuple = (),
        zones: tuple = (),
        settle: float = 2.0,
        z_min: float = -math.inf,
        z_max: float = math.inf,
        local_origin: str = "start",
        ground_down=None,
    ):
        zones = zones or polygon_zones(fence)
        facts = Facts("a", hover_throttle=0.5, has_battery=True, zones=zones, z_min=z_min, z_max=z_max)
        facts = replace(facts, local_origin=local_origin, ground_down=ground_down)  # type: ignore[arg-type]
        self.stack = FlightStack(facts, SITE, flavour=flavour, factor=factor)  # type: ignore[arg-type]
        self.seen = Seen(charge=0.8, present=0xF, healthy=0xF, altitude=488.0)
        self.order: Order | None = None
        self.said: list[Text] = []
        self.told: list[tuple[float, Event]] = []
        self.highest = self.fastest = 0.0
        self.run(settle)

    @property
    def texts(self) -> list[str]:
        """All that was said."""
        return [text.text for text in self.said]

    def kinds(self, kind: str) -> list[int]:
        """The numbers of all events of a kind."""
        return [event.number for _, event in self.told if event.kind == kind]

    def do(self, id: int, *params: float, frame: int = 0) -> int:
        """Give a command and return the result."""
        ack = self.stack.command(command(id, *params, frame=frame))
        assert isinstance(ack, Ack)
        return int(ack.result)

    def run(self, seconds: float, until=None, each=None) -> bool:
        """Fly for some time, or until something holds; return whether it did."""
        for _ in range(round(seconds / DT)):
            if each is not None:
                each(self)
            order = self.stack.tick(self.seen)
            self.order = order or self.order
            self._move()
            self.said += self.stack.texts()
            self.told += [(self.seen.time, event) for event in self.stack.events()]
            self.highest = max(self.highest, -self.seen.position_ned[2])
            self.fastest = max(self.fastest, math.hypot(*self.seen.velocity_ned[:2]))
            if until is not None and until(self):
                return True
        return until is None

    def fly_up(self, height: float = 10.0) -> None:
        """Arm, take off and hover."""
        assert self.do(400, 1) == 0
        assert self.do(22, NAN, NAN, NAN, NAN, NAN, NAN, 488.0 + height) == 0
        assert self.run(40.0, lambda now: now.stack.mode.value == "hold")
        self.run(3.0)

    def _move(self) -> None:
        seen = self.seen
        assert self.order is not None
        kind, numbers = self.order.kind, self.order.numbers
        # Single precision and its squares hold that.
        assert all(abs(number) < 2e6 for number in numbers), self.order
        here, speed = seen.position_ned, seen.velocity_ned
        if kind == "path":
            wanted = [numbers[3 + i] + 0.3 * numbers[6 + i] + 1.2 * (numbers[i] - here[i]) for i in range(3)]
        elif kind == "velocity":
            wanted = list(numbers[:3])
        else:
            # Level, it climbs with more than the throttle of hover, and falls with less.
            roll, pitch, _, throttle = numbers
            push = 9.81 * throttle / 0.5
            wanted = [speed[0] - push * pitch * 0.3, speed[1] + push * roll * 0.3, speed[2] + (9.81 - push) * 0.3]
        moved = [a + (b - a) * (DT / 0.3) for a, b in zip(speed, wanted, strict=True)]
        z = here[2] + moved[2] * DT
        seen.on_ground = z >= 0.0
        if seen.on_ground:
            moved, z = [0.0, 0.0, 0.0], 0.0
        seen.velocity_ned = (moved[0], moved[1], moved[2])
        seen.position_ned = (here[0] + moved[0] * DT, here[1] + moved[1] * DT, z)
        seen.attitude = (0.0, 0.0, numbers[3 if kind == "velocity" else 2 if kind == "attitude" else 9])
        north, east, _ = seen.position_ned
        seen.latitude, seen.longitude = 47.397742 + north * NORTH_DEG, 8.545594 + east * EAST_DEG
        seen.altitude = 488.0 - z
        seen.time = round(seen.time + DT, 6)


def flown(items: list, seconds: float = 120.0, **more) -> Puppet:
    """Return a puppet that has flown a mission."""
    puppet = Puppet(**more)
    assert puppet.stack.accept(PlanKind.MISSION, items) == (PlanResult.ACCEPTED, -1)
    assert puppet.do(300) == 0
    assert puppet.run(seconds, lambda now: now.stack.mission().state is MissionState.COMPLETE)
    return puppet
