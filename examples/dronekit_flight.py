"""Fly a vehicle of ``qrsim mavlink --flavour ardupilot`` by DroneKit: up, to a place, a mission, by set-points, home.

    qrsim mavlink --flavour ardupilot &
    python examples/dronekit_flight.py                       # or: ... tcp:127.0.0.1:5760, with --tcp

Needs ``pip install dronekit2``, which is DroneKit for today's Python. The same script flies ArduPilot's own simulation.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable

from dronekit import Command, LocationGlobalRelative, VehicleMode, connect
from pymavlink import mavutil

M = mavutil.mavlink
# Longest that a step may take by the wall clock [s].
PATIENCE = 120.0
# A place may be missed by so much [m]: the vehicle knows its own only as well as its GNSS.
NEAR = 1.5
POSITION_ONLY, VELOCITY_ONLY = 0xDF8, 0xDC7


def until(holds: Callable[[], bool], what: str, repeat: Callable[[], None] | None = None) -> None:
    """Wait until something holds; ``repeat`` is called twice a second meanwhile."""
    end, again = time.monotonic() + PATIENCE, 0.0
    while not holds():
        now = time.monotonic()
        if now > end:
            raise SystemExit(f"not in time: {what}")
        if repeat is not None and now - again > 0.5:
            again = now
            repeat()
        time.sleep(0.02)
    print(what, flush=True)


def main(address: str) -> None:
    """Fly."""
    vehicle = connect(address, wait_ready=True, rate=10)
    print(f"ArduPilot {vehicle.version}")
    reached: set[int] = set()
    vehicle.add_message_listener("MISSION_ITEM_REACHED", lambda _, name, message: reached.add(message.seq))

    until(lambda: bool(vehicle.is_armable), "may be armed")
    commands = vehicle.commands
    # Item 0 is home; with it a mission begins.
    commands.download()
    commands.wait_ready()
    home = vehicle.home_location

    def mode(name: str) -> None:
        vehicle.mode = VehicleMode(name)
        until(lambda: vehicle.mode.name == name, f"mode {name}")

    def away(latitude: float, longitude: float, height: float) -> float:
        here = vehicle.location.global_relative_frame
        north = (here.lat - latitude) * 111_200.0
        east = (here.lon - longitude) * 111_200.0 * math.cos(math.radians(latitude))
        return math.dist((north, east, here.alt), (0.0, 0.0, height))

    def local() -> tuple[float, float, float]:
        here = vehicle.location.local_frame
        return here.north, here.east, here.down

    def setpoint(mask: int, position: tuple[float, ...] = (0, 0, 0), velocity: tuple[float, ...] = (0, 0, 0)) -> None:
        message = vehicle.message_factory.set_position_target_local_ned_encode(
            0, 0, 0, M.MAV_FRAME_LOCAL_NED, mask, *position, *velocity, 0, 0, 0, 0, 0
        )
        vehicle.send_mavlink(message)

    mode("GUIDED")
    vehicle.armed = True
    until(lambda: bool(vehicle.armed), "armed")
    vehicle.simple_takeoff(8.0)
    until(lambda: vehicle.location.global_relative_frame.alt > 7.6, "took off")
    place = (home.lat + 2e-4, home.lon, 10.0)
    vehicle.simple_goto(LocationGlobalRelative(*place), groundspeed=4.0)
    until(lambda: away(*place) < NEAR, "there")

    commands.clear()
    corners = [(2e-4, 2e-4), (1e-4, 3e-4), (0.0, 2e-4), (0.0, 1e-4), (1e-4, 1e-4)]
    for number, (north, east) in enumerate(corners):
        commands.add(
            Command(0, 0, 0, M.MAV_FRAME_GLOBAL_RELATIVE_ALT, M.MAV_CMD_NAV_WAYPOINT, 0, 0, 0, 0, 0, 0,
                    home.lat + north, home.lon + east, 10.0 + number)
        )  # fmt: skip
    commands.upload(timeout=PATIENCE)
    mode("AUTO")
    until(lambda: reached >= set(range(1, len(corners) + 1)), "mission flown")

    mode("GUIDED")
    north, east, down = local()
    goal = (north + 8.0, east, down)
    # A place is said once.
    setpoint(POSITION_ONLY, position=goal)
    until(lambda: math.dist(local(), goal) < NEAR, "at the position of the set-point")
    along = lambda: setpoint(VELOCITY_ONLY, velocity=(0.0, 2.0, 0.0))  # noqa: E731
    until(lambda: local()[1] > goal[1] + 8.0 and vehicle.velocity[1] > 1.5, "flies by velocity", along)

    vehicle.parameters["RTL_RETURN_ALT"] = 15.0
    mode("RTL")
    until(lambda: vehicle.location.global_relative_frame.alt < 0.5, "landed")
    until(lambda: not vehicle.armed, "disarmed")
    vehicle.close()


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "udpin:127.0.0.1:14540")
