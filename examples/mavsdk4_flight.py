"""Fly a vehicle of ``qrsim mavlink`` by MAVSDK 4: up, to a place, a mission, by set-points, home, down.

    qrsim mavlink &
    python examples/mavsdk4_flight.py

Needs ``pip install "mavsdk>=4.1"``, whose interface is not that of version 3 (mavsdk_flight.py).
"""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import AsyncIterator, Callable
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission import MissionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.mission import MissionItem, MissionPlan
from mavsdk.plugins.offboard import PositionNedYaw, VelocityNedYaw

NAN = math.nan
# Longest that the whole flight may take [s, wall clock], and by how much a place may be missed [m].
PATIENCE, NEAR = 300.0, 1.5
METRES_PER_DEG = 111_200.0
ON_GROUND = 1


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


async def fly(mavsdk: Mavsdk, address: str) -> None:
    """Fly."""
    await mavsdk.add_any_connection(address)
    # Not get_systems(): a system that it returns before the first heartbeat never says anything.
    system = await mavsdk.first_autopilot(timeout_s=60.0)
    if system is None:
        raise SystemExit(f"{address}: no vehicle")
    telemetry, action, offboard = TelemetryAsync(system), ActionAsync(system), OffboardAsync(system)
    await until(telemetry.subscribe_health_all_ok(), bool, "all is well")
    home = await until(telemetry.subscribe_home(), lambda place: True, "home known")
    latitude, longitude, ground = home.latitude_deg, home.longitude_deg, home.absolute_altitude_m
    await ParamAsync(system).set_param_float("RTL_RETURN_ALT", 15.0)
    await action.set_takeoff_altitude(8.0)

    await action.arm()
    await action.takeoff()
    await until(telemetry.subscribe_position(), lambda here: abs(here.relative_altitude_m - 8.0) < NEAR, "took off")
    north = latitude + 2e-4
    await action.goto_location(north, longitude, ground + 10.0, NAN)
    await until(
        telemetry.subscribe_position(),
        lambda here: (
            abs(here.latitude_deg - north) * METRES_PER_DEG < NEAR and abs(here.relative_altitude_m - 10.0) < NEAR
        ),
        "there",
    )

    corners = [(2e-4, 2e-4), (1e-4, 3e-4), (0.0, 2e-4), (0.0, 1e-4), (1e-4, 1e-4)]
    items = [item(latitude + x, longitude + y, 10.0 + number) for number, (x, y) in enumerate(corners)]
    mission = MissionAsync(system)
    await mission.set_return_to_launch_after_mission(False)
    await mission.upload_mission(MissionPlan(items))
    await mission.start_mission()
    await until(mission.subscribe_mission_progress(), lambda done: done.current == done.total > 0, "mission flown")

    here = (await until(telemetry.subscribe_position_velocity_ned(), lambda now: True, "place known")).position
    goal = PositionNedYaw(here.north_m + 8.0, here.east_m, here.down_m, 0.0)
    await offboard.set_position_ned(goal)
    await offboard.start()
    await until(
        telemetry.subscribe_position_velocity_ned(),
        lambda now: math.hypot(now.position.north_m - goal.north_m, now.position.east_m - goal.east_m) < NEAR,
        "at the position of the set-point",
    )
    await offboard.set_velocity_ned(VelocityNedYaw(0.0, 2.0, 0.0, 0.0))
    await until(
        telemetry.subscribe_position_velocity_ned(),
        lambda now: now.position.east_m > goal.east_m + 8.0 and now.velocity.east_m_s > 1.5,
        "flies by velocity",
    )
    await offboard.stop()

    await action.return_to_launch()
    await until(telemetry.subscribe_landed_state(), lambda state: int(state) == ON_GROUND, "landed")
    await until(telemetry.subscribe_armed(), lambda armed: not armed, "disarmed")


async def main(address: str) -> None:
    """Connect and fly."""
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        await asyncio.wait_for(fly(mavsdk, address), PATIENCE)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "udpin://127.0.0.1:14540"))
