"""A world that waits for the clients of its vehicles: the same flight however long they take, and no wait for ever."""

from __future__ import annotations

import asyncio
import random
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from qrsim.links.mavlink.fleet import prepared
from qrsim.links.mavlink.frames import Reader
from qrsim.links.mavlink.ports import opened
from qrsim.links.mavlink.server import Server, Wire
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.world import FlownWorld
from qrsim.scenarios.scenario import load_scenario

pytestmark = pytest.mark.long

CONTENT = {
    "name": "two",
    "duration": 60.0,
    "world": {"wind": {"type": "log_shear", "speed_20ft": 4.0, "wind_from_deg": 270}, "turbulence": {"type": "dryden"}},
    "fleets": {
        "pair": {
            "controller": {"type": "cascade", "feed": "filter"},
            "sensors": {
                name: {"type": kind}
                for name, kind in (
                    ("gnss", "gnss_receiver"),
                    ("barometer", "barometer"),
                    ("attitude", "attitude_estimator"),
                    ("gyroscope", "gyroscope"),
                    ("accelerometer", "accelerometer"),
                )
            },
            "vehicles": [{"position_ned": [0, 0, 0]}, {"position_ned": [15, 0, 0]}],
        }
    },
}
# Answers of each client; after as many, when its receiver has long had fixes, the mode and the arming.
ANSWERS, ARMS_AT = 1400, 1200


class Client(asyncio.DatagramProtocol):
    """Answers each ATTITUDE of one vehicle by a set-point, some time later, and so many times."""

    def __init__(self, vehicle: int, port: int, slowness_s: float, answers: int = ANSWERS):
        self._vehicle, self._to = vehicle, ("127.0.0.1", port)
        self._slowness_s, self._answers = slowness_s, answers
        self._random = random.Random(vehicle)
        self._reader, self._pack = Reader(), common.MAVLink(None, srcSystem=200)
        self.heard = 0
        self.done = asyncio.Event()

    def connection_made(self, transport: Any) -> None:
        self._transport = transport
        self._say(self._target())

    def datagram_received(self, data: bytes, address: Any) -> None:
        for frame in self._reader.datagram(data):
            if frame.layout.name == "ATTITUDE":
                self.heard += 1
                asyncio.get_running_loop().call_later(self._random.uniform(0.0, self._slowness_s), self._answer)

    def _answer(self) -> None:
        if self.heard > self._answers:
            self.done.set()
            return
        if self.heard == ARMS_AT:
            number = self._vehicle + 1
            self._say(self._pack.command_long_encode(number, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0))
            self._say(self._pack.command_long_encode(number, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
        self._say(self._target())

    def _target(self) -> Any:
        # Position alone, over where it starts and 6 m up.
        return self._pack.set_position_target_local_ned_encode(
            0, self._vehicle + 1, 1, 1, 0xDF8, 15.0 * self._vehicle, 0.0, -6.0, 0, 0, 0, 0, 0, 0, 0, 0
        )

    def _say(self, message: Any) -> None:
        self._transport.sendto(message.pack(self._pack), self._to)


async def flown(
    world: FlownWorld, slowness_s: float, said: list[str], clients: int = 2, answers: int = ANSWERS
) -> list[Client]:
    """Fly until the clients are done; the world then stands and waits for them."""
    ports = opened(2, "127.0.0.1", False, False)
    server = asyncio.create_task(Server(world, ports, Wire(1000.0, lockstep=True), said.append).serve())
    loop, made = asyncio.get_running_loop(), []
    try:
        for vehicle in range(clients):
            client = Client(vehicle, ports.onboard + vehicle, slowness_s, answers)
            made.append(client)
            await loop.create_datagram_endpoint(lambda client=client: client, local_addr=("127.0.0.1", 0))
        await asyncio.wait_for(asyncio.gather(*(client.done.wait() for client in made)), 60.0)
    finally:
        server.cancel()
        await asyncio.gather(server, return_exceptions=True)
        ports.close()
    return made


def begun(seed: int = 3) -> FlownWorld:
    return FlownWorld(prepared(load_scenario(CONTENT)), FlightStack, seed=seed, factor=1000.0)


def test_two_runs_are_equal_to_the_bit_however_long_clients_take():
    ends = []
    for slowness_s in (0.0, 0.002):
        world = begun()
        asyncio.run(flown(world, slowness_s, []))
        # ATTITUDE goes out at every tick of 0.02 s, and each was answered but the last.
        assert world.simulation.tick == ANSWERS + 1
        ends.append(world.simulation.truth)
    assert (ends[0].position_ned[:, 2] < -0.5).all(), "they have taken off"
    for name in ("position_ned", "velocity_body", "attitude", "wind_ned"):
        np.testing.assert_array_equal(getattr(ends[0], name), getattr(ends[1], name))


def test_the_world_stands_until_every_vehicle_has_a_set_point_and_says_that_it_is_there():
    world, said = begun(), []
    with pytest.raises(asyncio.TimeoutError):
        asyncio.run(asyncio.wait_for(flown(world, 0.0, said, clients=1), 2.5))
    assert world.simulation.tick == 0
    assert "until every vehicle has a set-point" in said[0]


def test_who_is_silent_is_waited_for_a_second_and_no_longer():
    async def fly() -> None:
        # The first client stops after 30 answers and the second goes on.
        ports = opened(2, "127.0.0.1", False, False)
        server = asyncio.create_task(Server(world, ports, Wire(1000.0, lockstep=True), said.append).serve())
        loop = asyncio.get_running_loop()
        clients = [Client(vehicle, ports.onboard + vehicle, 0.0, 30 + 60 * vehicle) for vehicle in range(2)]
        for client in clients:
            await loop.create_datagram_endpoint(lambda client=client: client, local_addr=("127.0.0.1", 0))
        begin = loop.time()
        await asyncio.wait_for(clients[1].done.wait(), 30.0)
        waited.append(loop.time() - begin)
        server.cancel()
        await asyncio.gather(server, return_exceptions=True)
        ports.close()

    world, said, waited = begun(), [], []
    asyncio.run(fly())
    assert world.simulation.tick >= 91
    assert waited[0] >= 1.0
    assert [line.partition(": ")[2] for line in said[1:] if "'pair_0'" in line and "no set-point" in line] == [
        "no set-point for 1 s; the world goes on without waiting for it, until the next one"
    ]
