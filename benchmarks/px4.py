"""PX4's interface in lock-step with a stand-in that answers every frame: how many times faster than real time."""

from __future__ import annotations

import selectors
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

import _common

HEADINGS = {
    "what": "what",
    "vehicles": "vehicles",
    "rate_hz": "ticks/s",
    "real_time_factor": "times real time",
}
RATE_HZ, PORT, SCENARIO = 250.0, 24_560, "mavlink_field"
# HIL_SENSOR: number, and where it begins in a frame of version 2.
SENSOR, HEAD = 107, 10


def stand_in(vehicles: int) -> None:
    """Answer each HIL_SENSOR of some vehicles with stopped motors, until the simulator leaves."""
    from qrsim.links.mavlink.dialect import LAYOUTS
    from qrsim.links.mavlink.frames import frame

    layout = LAYOUTS["HIL_ACTUATOR_CONTROLS"]
    waiting = selectors.DefaultSelector()
    for instance in range(vehicles):
        wire = _connected(PORT + instance)
        waiting.register(wire, selectors.EVENT_READ, (instance, bytearray()))
    while waiting.get_map():
        for key, _ in waiting.select():
            wire, (instance, kept) = key.fileobj, key.data
            assert isinstance(wire, socket.socket)
            kept += wire.recv(65536) or b"\xff"
            if kept[0] == 0xFF:
                waiting.unregister(wire)
                continue
            while len(kept) > HEAD and len(kept) >= kept[1] + 12:
                if kept[7] == SENSOR:
                    (stamp,) = struct.unpack_from("<Q", kept, HEAD)
                    payload = layout.payload(time_usec=stamp, mode=129, flags=1)
                    wire.sendall(frame(layout.number, payload, 0, instance + 1))
                del kept[: kept[1] + 12]


def _connected(port: int) -> socket.socket:
    while True:
        try:
            wire = socket.create_connection(("127.0.0.1", port))
        except ConnectionRefusedError:
            time.sleep(0.01)
            continue
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return wire


def flown(vehicles: int, seconds: float) -> float:
    """Return the factor of a fleet with noisy sensors, without recording it."""
    from qrsim.links.autopilot.px4_flight import Px4Flight, prepared
    from qrsim.scenarios.scenario import load_scenario
    from qrsim.simulation.simulation import Simulation

    content = load_scenario(SCENARIO, quiet=True).spec.model_dump(mode="json")
    content["fleets"]["field"]["vehicles"] = content["fleets"]["field"]["vehicles"][:vehicles]
    scenario, fleets = prepared(load_scenario(content, quiet=True), (), "x500", RATE_HZ)
    simulation = Simulation(scenario.world(), seed=1, name=scenario.name, site=scenario.site)
    simulation.reset()
    with Px4Flight(simulation, fleets, 0, PORT, wait=30.0) as flight:
        pilots = subprocess.Popen([sys.executable, __file__, "--stand-in", str(vehicles)])
        flight.advance(50)  # connects and compiles
        begin = time.perf_counter()
        flight.advance(round(seconds * RATE_HZ))
        taken = time.perf_counter() - begin
    pilots.wait(10.0)
    return seconds / taken


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    rows: list[dict[str, Any]] = [
        {
            "what": "stand-in without a controller, noisy sensors",
            "vehicles": vehicles,
            "rate_hz": RATE_HZ,
            "real_time_factor": flown(vehicles, 0.5 if chosen.quick else 20.0),
        }
        for vehicles in ((1,) if chosen.quick else (1, 5))
    ]
    _common.publish("px4", "PX4's interface in lock-step with multirotors", on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    if "--stand-in" in sys.argv[1:]:
        stand_in(int(sys.argv[-1]))
    else:
        main()
