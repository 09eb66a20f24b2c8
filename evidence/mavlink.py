"""MAVLink: mutated frames of all kinds beside an honest flight, and whole flights of others' clients in a row."""

from __future__ import annotations

import hashlib
import math
import random
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from tests.links.mavlink import driven_clients as clients

from evidence._processes import resident_bytes
from qrsim.links.contracts import Order
from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.dialogue import handle
from qrsim.links.mavlink.fleet import prepared
from qrsim.links.mavlink.frames import Reader, frame
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.stack.contracts import Facts, Seen
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.streams import ONBOARD, Streams
from qrsim.links.mavlink.world import FlownWorld
from qrsim.models.site import Site
from qrsim.scenarios.scenario import load_scenario

DOC = "mutated MAVLink frames beside an honest flight, and ten flights in a row of each client"
SEED = 20261122
FULL, SMALL = 1_000_000, 20_000
TICKS = {True: 3000, False: 600}
FLIGHTS = 10
NAN = math.nan
CLIENT, VICTIM = 245, 2
EXAMPLES = {"pymavlink": "pymavlink_flight.py", "mavsdk3": "mavsdk_flight.py", "mavsdk4": "mavsdk4_flight.py"}
PLACE = {"x": 473978000, "y": 85456000, "z": 9.0}
ITEMS = ({"command": 22, "frame": 6}, {"command": 16, "frame": 6, "param1": 1.0, **PLACE}, {"command": 21, "frame": 6})


class Replayed(FlightStack):
    """A stack that repeats orders, one at each tick."""

    orders: Iterator[Order | None] = iter(())

    def tick(self, seen: Seen) -> Order | None:
        """Return the next order."""
        return next(self.orders, None)


class Flight:
    """A world whose first vehicle is flown honestly, by ticks; the second one hears what is mutated.

    Args:
        orders: of the second vehicle, which hears nothing then; None: it does as it hears.
    """

    def __init__(self, orders: Sequence[Order | None] | None = None) -> None:
        scenario = load_scenario("mavlink_field", quiet=True)

        def make(facts: Facts, site: Site) -> FlightStack:
            if orders is None or facts.system != VICTIM:
                return FlightStack(facts, site)
            stack = Replayed(facts, site)
            stack.orders = iter(orders)
            return stack

        self.world = FlownWorld(prepared(scenario), make, seed=1)
        self.answers = 0
        for system in self.world.systems[:2]:
            system.links.append(Link(system.number, Streams(ONBOARD, 0.02), self._sent))
        self.readers = [Reader(), Reader()]
        self.errors: list[str] = []
        self._hash = hashlib.sha256()

    def _sent(self, data: bytes) -> None:
        self.answers += 1

    def hear(self, vehicle: int, data: bytes) -> None:
        """Hand bytes to the socket of a vehicle."""
        system = self.world.systems[vehicle]
        for read in self.readers[vehicle].datagram(data):
            try:
                handle(system, system.links[0], read)
            except Exception as error:
                self.errors.append(f"{read.layout.name}: {type(error).__name__}: {error}")

    def ask(self, name: str, **values: Any) -> None:
        """Send a message of the honest client."""
        layout = LAYOUTS[name]
        self.hear(0, frame(layout.number, layout.payload(**values), 0, CLIENT, 190))

    def tick(self) -> None:
        """Advance, with what the honest client does then."""
        tick = self.world.simulation.tick
        to = {"target_system": 1, "target_component": 1}
        if tick == 100:
            self.ask("MISSION_COUNT", **to, count=len(ITEMS))
            for seq, item in enumerate(ITEMS):
                self.ask("MISSION_ITEM_INT", **to, seq=seq, **{"z": 8.0, "param4": NAN, **item})
            self.ask("COMMAND_LONG", **to, command=400, param1=1.0)
            self.ask("COMMAND_LONG", **to, command=300)
        self.world.tick(0.0)
        self._hash.update(self.world.simulation.truth.position_ned[0].tobytes())

    @property
    def bits(self) -> str:
        """All places of the honest vehicle so far, as a hash."""
        return self._hash.hexdigest()


def mutated(draw: random.Random, seen: list[bytes]) -> tuple[int, bytes]:
    """Return for which vehicle, and a frame: whole but with any content, harmed, cut off, of others, or replayed."""
    layout = draw.choice(tuple(LAYOUTS.values()))
    payload = bytearray(draw.randbytes(layout.struct.size))
    kind = draw.randrange(5)
    if kind == 0 and seen:
        return 1, draw.choice(seen)
    if kind == 1:
        whole = bytearray(frame(layout.number, bytes(payload), draw.randrange(256), CLIENT, 190))
        whole[draw.randrange(len(whole))] ^= 1 << draw.randrange(8)
        return draw.randrange(2), bytes(whole)
    if kind == 2:
        whole = bytearray(frame(layout.number, bytes(payload), draw.randrange(256), CLIENT, 190))
        return draw.randrange(2), bytes(whole[: draw.randrange(len(whole))])
    if kind == 3:
        return draw.randrange(2), _to_another(draw, layout)
    values = _plausible(draw, layout)
    whole = frame(layout.number, layout.payload(**values), draw.randrange(256), draw.randrange(256), 190)
    if len(seen) < 1000:
        seen.append(whole)
    return 1, whole


def _to_another(draw: random.Random, layout: Any) -> bytes:
    """Return a whole frame for a system that is not there; commands and the like, which have a target."""
    names = [name for name, each in LAYOUTS.items() if any(field.name == "target_system" for field in each.fields)]
    layout = LAYOUTS[draw.choice(names)]
    values = _plausible(draw, layout) | {"target_system": draw.randrange(3, 256)}
    return frame(layout.number, layout.payload(**values), draw.randrange(256), CLIENT, 190)


def _plausible(draw: random.Random, layout: Any) -> dict[str, Any]:
    """Return fields as a client might fill them: for this vehicle, with numbers that mean something or do not."""
    found: dict[str, Any] = {}
    for field in layout.fields:
        count = field.count or 1
        if field.type == "c":
            found[field.name] = draw.choice((b"RTL_RETURN_ALT", b"GF_ACTION", b"\xff\xfe", draw.randbytes(field.count)))
            continue
        numbers = [_number(draw, field.type) for _ in range(count)]
        found[field.name] = numbers if field.count else numbers[0]
    if "target_system" in found:
        found |= {"target_system": draw.choice((0, VICTIM)), "target_component": draw.choice((0, 1))}
    if "command" in found:
        found["command"] = draw.choice(
            (16, 20, 21, 22, 176, 178, 179, 185, 192, 224, 300, 400, 511, 512, 5001, draw.randrange(65536))
        )
    if "count" in found:
        found["count"] = draw.choice((0, 1, 3, 1000, draw.randrange(65536)))
    if "seq" in found:
        found["seq"] = draw.randrange(4)
    if "mission_type" in found:
        found["mission_type"] = draw.choice((0, 1, 2, 255, draw.randrange(256)))
    known = {field.name for field in layout.fields}
    return {name: value for name, value in found.items() if name in known}


def _number(draw: random.Random, kind: str) -> float | int:
    if kind == "f":
        return draw.choice((0.0, 1.0, -1.0, NAN, math.inf, -math.inf, 1e-40, 3e38, 47.4, 8.5, draw.uniform(-1e3, 1e3)))
    size = {"B": 8, "H": 16, "I": 32, "Q": 64, "b": 8, "h": 16, "i": 32, "q": 64}[kind]
    low = 0 if kind.isupper() else -(2 ** (size - 1))
    high = 2**size - 1 if kind.isupper() else 2 ** (size - 1) - 1
    return draw.choice((0, 1, 2, low, high, draw.randint(low, high)))


def fuzzed(frames: int, ticks: int) -> dict[str, Any]:
    """Compare a flight that is sent mutated frames with the same flight without them.

    The other vehicle, which heard them, flies by the same orders in both: where it touches the ground, the numbers of
    all vehicles of its fleet are rounded otherwise.
    """
    beside, draw, seen = Flight(), random.Random(SEED), []
    victim = beside.world.systems[VICTIM - 1].view
    orders = [victim.order]
    each, before = frames // ticks, 0
    for tick in range(ticks):
        for _ in range(each):
            beside.hear(*mutated(draw, seen))
        beside.tick()
        orders.append(victim.order)
        if tick == ticks // 5:
            before = resident_bytes()
    alone = Flight(orders)
    for _ in range(ticks):
        alone.tick()
    for line in sorted(set(beside.errors))[:10]:
        print(line)
    return {
        "frames": each * ticks,
        "exceptions": len(beside.errors),
        "flights_that_differ": int(beside.bits != alone.bits),
        "last_height_m": round(float(-alone.world.simulation.truth.position_ned[0, 2]), 2),
        "growth_mb": round((resident_bytes() - before) / 1e6, 1),
    }


def flights(client: str, count: int, factor: float) -> int:
    """Return how many of so many flights of a client were whole."""
    python = sys.executable if client == "pymavlink" else clients.environment(client)
    whole = 0
    for _ in range(count):
        field = clients.Field(factor=factor)
        try:
            address = f"udpin:127.0.0.1:{field.port}" if client == "pymavlink" else f"udpin://127.0.0.1:{field.port}"
            more = ("50071",) if client == "mavsdk3" else ()
            whole += clients.fly(python, EXAMPLES[client], address, *more) == list(clients.STEPS)
        finally:
            field.end()
    return whole


def run(full: bool) -> dict[str, Any]:
    """Return what became of mutated frames; the full form flies ten times with each client, and once in real time."""
    found: dict[str, Any] = {"fuzz": fuzzed(FULL if full else SMALL, TICKS[full])}
    if full:
        found["flights"] = FLIGHTS
        found["whole"] = {client: flights(client, FLIGHTS, clients.FACTOR) for client in EXAMPLES}
        found["whole_in_real_time"] = {client: flights(client, 1, 1.0) for client in EXAMPLES}
    return found
