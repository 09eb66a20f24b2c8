"""Fly a vehicle of ``qrsim mavlink`` by MAVSDK: a fence, an attitude, an orbit, follow-me, sticks, down.

    qrsim mavlink &
    python examples/mavsdk_modes.py

Needs ``pip install "mavsdk<4"``. The same script flies PX4's own simulation.
"""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import AsyncIterator, Callable
from typing import Any

from mavsdk import System
from mavsdk.action import OrbitYawBehavior
from mavsdk.follow_me import Config, TargetLocation
from mavsdk.geofence import Circle, FenceType, GeofenceData, Point, Polygon
from mavsdk.offboard import Attitude
from mavsdk.telemetry import FlightMode

# Longest that the whole flight may take [s, wall clock].
PATIENCE = 300.0
METRES_PER_DEG = 111_200.0


async def until(stream: AsyncIterator[Any], holds: Callable[[Any], bool], what: str) -> Any:
    """Wait for what a stream says, and return it."""
    async for found in stream:
        if holds(found):
            print(what, flush=True)
            return found
    raise SystemExit(f"the stream has ended: {what}")


async def fence(drone: System, latitude: float, longitude: float) -> None:
    """Upload a square of 400 m; a circle of radius 0 is none."""
    corners = [
        Point(latitude + x, longitude + y) for x, y in ((-2e-3, -3e-3), (-2e-3, 3e-3), (2e-3, 3e-3), (2e-3, -3e-3))
    ]
    nothing = Circle(Point(0.0, 0.0), 0.0, FenceType.INCLUSION)
    await drone.geofence.upload_geofence(GeofenceData([Polygon(corners, FenceType.INCLUSION)], [nothing]))
    print("fence uploaded", flush=True)


async def lean(drone: System) -> None:
    """Take off by 70 % of thrust, where 50 % carry the vehicle, and hold."""
    await drone.offboard.set_attitude(Attitude(0.0, 0.0, 0.0, 0.0))
    await drone.offboard.start()
    await drone.offboard.set_attitude(Attitude(0.0, 0.0, 0.0, 0.7))
    await until(drone.telemetry.position(), lambda here: here.relative_altitude_m > 6.0, "rises by attitude")
    await drone.offboard.stop()


async def orbit(drone: System, latitude: float, longitude: float, altitude: float) -> None:
    """Go round a place, 20 m away from it."""
    await drone.action.do_orbit(20.0, 5.0, OrbitYawBehavior.HOLD_FRONT_TO_CIRCLE_CENTER, latitude, longitude, altitude)
    scale = math.cos(math.radians(latitude))

    def away(here: Any) -> float:
        north, east = here.latitude_deg - latitude, (here.longitude_deg - longitude) * scale
        return METRES_PER_DEG * math.hypot(north, east)

    await until(drone.telemetry.position(), lambda here: abs(away(here) - 20.0) < 2.0, "on the circle")
    await until(drone.telemetry.velocity_ned(), lambda now: now.east_m_s > 3.0, "orbits")


async def follow(drone: System, latitude: float, longitude: float, altitude: float) -> None:
    """Follow a target that goes north at 4 m/s, from 10 m behind and above."""
    height, distance, responsiveness, fastest, behind = 10.0, 10.0, 0.1, 5.0, 180.0
    mode = Config.FollowAltitudeMode.CONSTANT
    await drone.follow_me.set_config(Config(height, distance, responsiveness, mode, fastest, behind))
    await drone.follow_me.start()
    await until(drone.telemetry.flight_mode(), lambda now: now is FlightMode.FOLLOW_ME, "in follow-me")
    velocities = drone.telemetry.velocity_ned()
    done = asyncio.create_task(
        until(velocities, lambda now: 3.0 < now.north_m_s < 5.0 and abs(now.east_m_s) < 1.0, "follows")
    )
    north = 0.0
    while not done.done():
        place = latitude + north / METRES_PER_DEG, longitude, altitude
        await drone.follow_me.set_target_location(TargetLocation(*place, 4.0, 0.0, 0.0))
        await asyncio.sleep(0.2)
        north += 0.8
    await drone.follow_me.stop()


async def push(drone: System, pitch: float, throttle: float, done: asyncio.Task[Any]) -> None:
    """Hold sticks until something is done."""
    while not done.done():
        await drone.manual_control.set_manual_control_input(pitch, 0.0, throttle, 0.0)
        await asyncio.sleep(0.05)


async def steer(drone: System) -> None:
    """Fly backwards by sticks, and down to the ground."""
    await drone.manual_control.set_manual_control_input(0.0, 0.0, 0.5, 0.0)
    await drone.manual_control.start_position_control()
    velocities = drone.telemetry.velocity_ned()
    await push(drone, -1.0, 0.5, asyncio.create_task(until(velocities, lambda now: now.north_m_s < -3.0, "steered")))
    armed = drone.telemetry.armed()
    await push(drone, 0.0, 0.0, asyncio.create_task(until(armed, lambda armed: not armed, "landed by sticks")))


async def main(address: str, port: int) -> None:
    """Fly; ``port`` is that of MAVSDK's own server."""
    drone = System(port=port)
    await drone.connect(system_address=address)
    await until(drone.core.connection_state(), lambda state: state.is_connected, "connected")
    await until(drone.telemetry.health_all_ok(), bool, "all is well")
    home = await until(drone.telemetry.home(), lambda place: True, "home known")
    latitude, longitude, ground = home.latitude_deg, home.longitude_deg, home.absolute_altitude_m
    await fence(drone, latitude, longitude)
    await drone.action.arm()
    await lean(drone)
    await orbit(drone, latitude, longitude, ground + 15.0)
    await follow(drone, latitude, longitude, ground)
    await steer(drone)


if __name__ == "__main__":
    given = sys.argv[1:] + ["udpin://127.0.0.1:14540", "50051"][len(sys.argv) - 1 :]
    asyncio.run(asyncio.wait_for(main(given[0], int(given[1])), PATIENCE))
