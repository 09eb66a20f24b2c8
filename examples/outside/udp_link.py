"""A link: lines of text over UDP fly a vehicle, "velocity 1 0 0 0" (north, east, down [m/s], yaw [rad]).

Each line is answered with the vehicle's position and velocity, or with what is wrong with it. Who says nothing for half
a second has left: the vehicle holds its place. Run it, then: echo velocity 1 0 0 0 | nc -u localhost 14600
"""

import math
import socket
import sys
import time

import qrsim
from qrsim.contracts import Order, Plant, Silence
from qrsim.errors import UsageError

ME = 1


class UdpLink:
    """One vehicle of a simulation, commanded from a socket that never blocks."""

    def __init__(self, simulation, vehicle, port=0):
        self.simulation, self.vehicle = simulation, vehicle
        self.plant = Plant(simulation, Silence("hold", 0.5))
        self.plant.claim(ME, [vehicle])
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))
        self.socket.setblocking(False)

    def step(self, ticks=1):
        """Obey what has arrived, and fly some ticks."""
        while (packet := self.received()) is not None:
            self.socket.sendto(self.answer(packet[0]).encode(), packet[1])
        self.simulation.advance(self.plant.begin(), ticks)

    def received(self):
        """Return the next packet and its sender, None where there is none."""
        try:
            return self.socket.recvfrom(512)
        except BlockingIOError:
            return None

    def answer(self, packet):
        """Take an order, and return the reply."""
        try:
            kind, *words = packet.decode("ascii").split()
            order = Order(self.vehicle, kind, tuple(map(float, words)))
            self.plant.check(ME, [order])
        except (UsageError, ValueError) as error:
            return f"error: {error}"
        self.plant.order([order])
        row = self.simulation.vehicle_names.index(self.vehicle)
        truth = self.simulation.truth
        numbers = [*truth.position_ned[row], *truth.velocity_ned[row]]
        return " ".join(f"{number:.3f}" for number in numbers)


if __name__ == "__main__":
    flown = qrsim.load("hover_ideal", overrides=["fleets.pelicans.controller=offboard"])
    flown.reset()
    link = UdpLink(flown, flown.vehicle_names[0], 14600)
    begin = time.monotonic()
    until = float(sys.argv[1]) if len(sys.argv) > 1 else math.inf
    while flown.time < until:
        link.step()
        time.sleep(max(0.0, begin + flown.time - time.monotonic()))
