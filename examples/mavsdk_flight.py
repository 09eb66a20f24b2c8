"""Fly a vehicle of ``qrsim mavlink`` by MAVSDK: up, to a place, a mission, by set-points, home, down.

    qrsim mavlink &
    python examples/mavsdk_flight.py

Needs ``pip install "mavsdk<4"``. The same script flies PX4's own simulation.
"""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import AsyncIterator, Callable
from typing import Any

from mavsdk import System
from mavsdk.mission import MissionItem, MissionPlan
from mavsdk.offboard import PositionNedYaw, VelocityNedYaw

NAN = math.nan
# Longest that the whole flight may take [s, wall clock], and by how much a place may be missed [m].
PATIENCE, NEAR = 300.0, 1.5
METRES_PER_DEG = 111_200.0


async def until(stream: AsyncIterator[Any], holds: Callable[[Any], bool], what: str) -> Any:
    """Wait for what a stream says, and return it."""
    async for found in stream:
        if holds(found):
            print(what, flush=True)
            return found
    raise SystemExit(f"the stream has ended: {what}")


def item(latitude: float, longitude: float, height: float) -> MissionItem:
    """Return a place of a mission, where the vehicle stops."""
    return MissionItem(
        latitude, longitude, height, 5.0, False, NAN, NAN, MissionItem.CameraAction.NONE, NAN, NAN, 1.0, NAN, NAN,
        MissionItem.VehicleAction.NONE,
    )  # fmt: skip


async def main(address: str, port: int) -> None:
    """Fly; ``port`` is that of MAVSDK's own server."""
    drone = System(port=port)
    await drone.connect(system_address=address)
    telemetry, action = drone.telemetry, drone.action
    await until(drone.core.connection_state(), lambda state: state.is_connected, "connected")
    await until(telemetry.health_all_ok(), bool, "all is well")
    home = await until(telemetry.home(), lambda place: True, "home known")
    latitude, longitude, ground = home.latitude_deg, home.longitude_deg, home.absolute_altitude_m
    await drone.param.set_param_float("RTL_RETURN_ALT", 15.0)
    await action.set_takeoff_altitude(8.0)

    await action.arm()
    await action.takeoff()
    await until(telemetry.position(), lambda here: abs(here.relative_altitude_m - 8.0) < NEAR, "took off")
    north = latitude + 2e-4
    await action.goto_location(north, longitude, ground + 10.0, NAN)
    await until(
        telemetry.position(),
        lambda here: (
            abs(here.latitude_deg - north) * METRES_PER_DEG < NEAR and abs(here.relative_altitude_m - 10.0) < NEAR
        ),
        "there",
    )

    corners = [(2e-4, 2e-4), (1e-4, 3e-4), (0.0, 2e-4), (0.0, 1e-4), (1e-4, 1e-4)]
    items = [item(latitude + x, longitude + y, 10.0 + number) for number, (x, y) in enumerate(corners)]
    await drone.mission.set_return_to_launch_after_mission(False)
    await drone.mission.upload_mission(MissionPlan(items))
    print(f"mission of {len((await drone.mission.download_mission()).mission_items)} items is there")
    await drone.mission.start_mission()
    progress = drone.mission.mission_progress()
    await until(progress, lambda done: done.current == done.total, "mission flown")
    print(f"finished: {await drone.mission.is_mission_finished()}")

    here = (await until(telemetry.position_velocity_ned(), lambda now: True, "place known")).position
    goal = PositionNedYaw(here.north_m + 8.0, here.east_m, here.down_m, 0.0)
    await drone.offboard.set_position_ned(goal)
    await drone.offboard.start()
    await until(
        telemetry.position_velocity_ned(),
        lambda now: math.hypot(now.position.north_m - goal.north_m, now.position.east_m - goal.east_m) < NEAR,
        "at the position of the set-point",
    )
    await drone.offboard.set_velocity_ned(VelocityNedYaw(0.0, 2.0, 0.0, 0.0))
    await until(
        telemetry.position_velocity_ned(),
        lambda now: now.position.east_m > goal.east_m + 8.0 and now.velocity.east_m_s > 1.5,
        "flies by velocity",
    )
    await drone.offboard.stop()

    await action.return_to_launch()
    await until(telemetry.landed_state(), lambda state: str(state) == "ON_GROUND", "landed")
    await until(telemetry.armed(), lambda armed: not armed, "disarmed")


if __name__ == "__main__":
    given = sys.argv[1:] + ["udpin://127.0.0.1:14540", "50051"][len(sys.argv) - 1 :]
    asyncio.run(asyncio.wait_for(main(given[0], int(given[1])), PATIENCE))
