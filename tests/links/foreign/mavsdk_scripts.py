"""What the public examples of MAVSDK-Python do, one flight each, with what a user expects to see.

    python evidence/_foreign/mavsdk_scripts.py SCRIPT ADDRESS PORT [VEHICLE [FACTOR]]

For MAVSDK 2 and 3 (package ``mavsdk``) and for version 4 (package ``mavsdk-grpc``), whose interface is the same.
VEHICLE, from 0, keeps those apart that fly the same script at once: places on the Earth are 6 m higher for each.
FACTOR is that of ``qrsim mavlink --realtime``, by which waits are shorter.
"""

from __future__ import annotations

import asyncio
import importlib.util
import math
import os
import sys
import traceback
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

NAME = "mavsdk_grpc" if importlib.util.find_spec("mavsdk_grpc") else "mavsdk"
mavsdk = importlib.import_module(NAME)


def part(name: str) -> Any:
    """Return a module of MAVSDK."""
    return importlib.import_module(f"{NAME}.{name}")


NAN = math.nan
PATIENCE = 280.0
METRES_PER_DEG = 111_200.0
NEAR = 1.5


class Flight:
    """One vehicle and its script."""

    def __init__(self, port: int, vehicle: int, factor: float) -> None:
        self.drone = mavsdk.System(port=port)
        self.vehicle, self.factor = vehicle, factor
        self.home: Any = None

    # ---- what all scripts do ----

    async def connect(self, address: str) -> None:
        """Connect, and wait until position and home are known."""
        await self.drone.connect(system_address=address)
        await first(self.drone.core.connection_state(), lambda state: state.is_connected)
        await first(self.drone.telemetry.health(), lambda now: now.is_global_position_ok and now.is_home_position_ok)
        self.home = await first(self.drone.telemetry.home())

    async def wait(self, seconds: float) -> None:
        """Wait for simulated seconds."""
        await asyncio.sleep(seconds / self.factor)

    def place(self, north: float, east: float) -> tuple[float, float]:
        """Return latitude and longitude, so many metres from home."""
        scale = METRES_PER_DEG * math.cos(math.radians(self.home.latitude_deg))
        return self.home.latitude_deg + north / METRES_PER_DEG, self.home.longitude_deg + east / scale

    async def local(self) -> Any:
        """Return position and velocity of now."""
        return await first(self.drone.telemetry.position_velocity_ned())

    async def at(self, north: float, east: float, down: float, near: float = NEAR) -> None:
        """Wait until it is at a place of its local frame."""

        def there(now: Any) -> bool:
            here = now.position
            return math.dist((here.north_m, here.east_m, here.down_m), (north, east, down)) < near

        await first(self.drone.telemetry.position_velocity_ned(), there)

    async def moves(self, north: float, east: float, down: float, near: float = 0.7) -> None:
        """Wait until it flies at a velocity."""

        def does(now: Any) -> bool:
            v = now.velocity
            return math.dist((v.north_m_s, v.east_m_s, v.down_m_s), (north, east, down)) < near

        await first(self.drone.telemetry.position_velocity_ned(), does)

    async def take_off(self, height: float = 2.5) -> None:
        """Arm and take off."""
        drone = self.drone
        if height != 2.5:
            await drone.action.set_takeoff_altitude(height)
        await drone.action.arm()
        await drone.action.takeoff()
        await first(drone.telemetry.position(), lambda here: abs(here.relative_altitude_m - height) < NEAR)

    async def disarmed(self) -> None:
        """Wait until it is on the ground and disarmed."""
        on_ground = part("telemetry").LandedState.ON_GROUND
        await first(self.drone.telemetry.landed_state(), lambda state: state == on_ground)
        await first(self.drone.telemetry.armed(), lambda armed: not armed)

    async def home_again(self) -> None:
        """Return, land and be disarmed."""
        await self.drone.param.set_param_float("RTL_RETURN_ALT", 12.0 + 6.0 * self.vehicle)
        await self.drone.action.return_to_launch()
        await self.disarmed()

    async def offboard(self, begin: Callable[[], Awaitable[None]]) -> Any:
        """Arm and start OFFBOARD with a first set-point."""
        await self.drone.action.arm()
        for _ in range(3):
            await begin()
            try:
                await self.drone.offboard.start()
                break
            except part("offboard").OffboardError as error:
                # MAVSDK forgets a set-point at a heartbeat of another mode, which may come between the two calls.
                if "NO_SETPOINT_SET" not in str(error):
                    raise
        return self.drone.offboard

    # ---- the scripts ----

    async def takeoff_and_land(self) -> None:
        """Up to 2.5 m and down, in the air between."""
        await self.take_off()
        assert await first(self.drone.telemetry.in_air())
        await self.drone.action.land()
        await self.disarmed()

    async def goto(self) -> None:
        """To a place on the Earth, 20 m and more above home."""
        await self.take_off()
        latitude, longitude = self.place(120.0, -90.0)
        up = 20.0 + 6.0 * self.vehicle
        await self.drone.param.set_param_float("MPC_XY_CRUISE", 8.0)
        await self.drone.action.goto_location(latitude, longitude, self.home.absolute_altitude_m + up, 0.0)
        await first(
            self.drone.telemetry.position(),
            lambda here: (
                abs(here.latitude_deg - latitude) * METRES_PER_DEG < NEAR and abs(here.relative_altitude_m - up) < 2.0
            ),
        )
        await self.home_again()

    async def mission(self) -> None:
        """Three places at 25 m, flown through, and home; progress is told."""
        module, up, drone = part("mission"), 25.0 + 6.0 * self.vehicle, self.drone
        rest = (NAN, NAN, module.MissionItem.CameraAction.NONE, NAN, NAN, NAN, NAN, NAN)
        last = module.MissionItem.VehicleAction.NONE
        items = [
            module.MissionItem(*self.place(north, east), up, 10.0, True, *rest, last)
            for north, east in ((33.0, 0.0), (33.0, -44.0), (9.0, -44.0))
        ]
        await drone.mission.set_return_to_launch_after_mission(True)
        await drone.param.set_param_float("RTL_RETURN_ALT", up)
        await drone.mission.upload_mission(module.MissionPlan(items))
        await drone.action.arm()
        await drone.mission.start_mission()
        # The way home is an item of its own for some versions.
        await first(drone.mission.mission_progress(), lambda done: done.total >= 3 and done.current >= 3)
        await self.disarmed()

    async def mission_raw(self) -> None:
        """Two items go up and come down again, and are cleared."""
        module, drone = part("mission_raw"), self.drone
        x, y = (round(number * 1e7) for number in self.place(553.0, -207.0))
        items = [
            module.MissionItem(seq, 6, 16, int(seq == 0), 1, 0.0, 10.0, 0.0, NAN, x, y + 7700 * seq, 30.0, 0)
            for seq in (0, 1)
        ]
        await drone.mission_raw.upload_mission(items)
        found = await drone.mission_raw.download_mission()
        assert [(one.seq, one.command, one.x, one.y, one.z) for one in found] == [
            (one.seq, one.command, one.x, one.y, one.z) for one in items
        ], found
        await drone.mission_raw.clear_mission()
        assert await drone.mission_raw.download_mission() == []

    async def offboard_position(self) -> None:
        """Each vehicle starts at (0, 0, 0) of its frame, and flies to four places with headings, one on the ground.

        A new place every 10 s, as in the example: two that begin together fly side by side.
        """
        module, here = part("offboard"), (await self.local()).position
        # In later rounds it starts where it landed, in the frame of its first start.
        assert self.factor > 1.0 or math.hypot(here.north_m, here.east_m, here.down_m) < 1.5, here
        offboard = await self.offboard(
            lambda: self.drone.offboard.set_position_ned(module.PositionNedYaw(0.0, 0.0, 0.0, 0.0))
        )
        for north, east, down, yaw in ((0.0, 0.0, -5.0, 0.0), (5.0, 0.0, -5.0, 90.0), (5.0, 10.0, -5.0, 90.0)):
            rest = asyncio.create_task(self.wait(10.0))
            await offboard.set_position_ned(module.PositionNedYaw(north, east, down, yaw))
            await self.at(north, east, down)
            await first(self.drone.telemetry.attitude_euler(), lambda now, yaw=yaw: abs(now.yaw_deg - yaw) < 10.0)
            await rest
        await offboard.set_position_ned(module.PositionNedYaw(0.0, 10.0, 0.0, 180.0))
        await self.wait(10.0)
        # The example ends here: on the ground, or above it by what the estimate of height has drifted.
        await self.stop()
        if await first(self.drone.telemetry.armed()):
            await self.drone.action.land()
        await self.disarmed()

    async def stop(self) -> None:
        """Stop OFFBOARD, which may have ended by itself."""
        error = part("offboard").OffboardError
        try:
            await self.drone.offboard.stop()
        except error as said:
            print(f"offboard.stop: {said}")

    async def offboard_velocity(self) -> None:
        """Velocities north, south, west, east with headings, and down."""
        module = part("offboard")
        offboard = await self.offboard(
            lambda: self.drone.offboard.set_velocity_ned(module.VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        )
        for north, east, down, yaw in (
            (0.0, 0.0, -2.0, 0.0), (2.0, 0.0, 0.0, 90.0), (-2.0, 0.0, 0.0, 270.0), (0.0, -2.0, 0.0, 90.0),
            (0.0, 2.0, 0.0, 90.0), (0.0, 0.0, 0.0, 180.0), (0.0, 0.0, 1.0, 0.0),
        ):  # fmt: skip
            await offboard.set_velocity_ned(module.VelocityNedYaw(north, east, down, yaw))
            await self.moves(north, east, down)
            await self.wait(3.0 if down <= 0.0 else 0.0)
        await self.stop()
        await self.drone.action.land()
        await self.disarmed()

    async def offboard_body(self) -> None:
        """A climb with a turn, a circle ahead and one sideways."""
        module = part("offboard")
        still = module.VelocityBodyYawspeed(0.0, 0.0, 0.0, 0.0)
        offboard = await self.offboard(lambda: self.drone.offboard.set_velocity_body(still))
        await offboard.set_velocity_body(module.VelocityBodyYawspeed(0.0, 0.0, -1.0, 60.0))
        await first(self.drone.telemetry.position(), lambda here: here.relative_altitude_m > 4.0)
        await offboard.set_velocity_body(still)
        await self.wait(2.0)
        for forward, right in ((5.0, 0.0), (0.0, -5.0)):
            await offboard.set_velocity_body(module.VelocityBodyYawspeed(forward, right, 0.0, 30.0))
            for axis in (1.0, -1.0):
                # All the way round.
                await first(
                    self.drone.telemetry.position_velocity_ned(),
                    lambda now, axis=axis: axis * now.velocity.north_m_s > 3.0,
                )
            await offboard.set_velocity_body(still)
            await self.moves(0.0, 0.0, 0.0)
        await self.stop()
        await self.home_again()

    async def offboard_attitude(self) -> None:
        """Thrust 70 %, then 30 degrees to the right and to the left at 60 %, and down."""
        module = part("offboard")
        level = module.Attitude(0.0, 0.0, 0.0, 0.0)
        offboard = await self.offboard(lambda: self.drone.offboard.set_attitude(level))
        await offboard.set_attitude(module.Attitude(0.0, 0.0, 0.0, 0.7))
        await first(self.drone.telemetry.position(), lambda here: here.relative_altitude_m > 2.0)
        for roll in (30.0, -30.0):
            await offboard.set_attitude(module.Attitude(roll, 0.0, 0.0, 0.6))
            await first(self.drone.telemetry.attitude_euler(), lambda now, roll=roll: abs(now.roll_deg - roll) < 5.0)
        await offboard.set_attitude(module.Attitude(0.0, 0.0, 0.0, 0.6))
        await first(self.drone.telemetry.attitude_euler(), lambda now: abs(now.roll_deg) < 5.0)
        await self.stop()
        await self.home_again()

    async def offboard_position_velocity(self) -> None:
        """To 10 m with a velocity up, and 50 m north with one ahead."""
        module = part("offboard")
        offboard = await self.offboard(
            lambda: self.drone.offboard.set_position_ned(module.PositionNedYaw(0.0, 0.0, 0.0, 0.0))
        )
        for place, along in (((0.0, 0.0, -10.0), (0.0, 0.0, -1.0)), ((50.0, 0.0, -10.0), (1.0, 0.0, 0.0))):
            await offboard.set_position_velocity_ned(
                module.PositionNedYaw(*place, 0.0), module.VelocityNedYaw(*along, 0.0)
            )
            # Before the place or beyond, by its velocity.
            await self.at(*place, near=2.5)
        await self.drone.action.land()
        await self.disarmed()

    async def offboard_from_csv(self) -> None:
        """A circle of 10 m at 10 m, told ten times a second with its velocity; then down."""
        module = part("offboard")
        offboard = await self.offboard(
            lambda: self.drone.offboard.set_position_ned(module.PositionNedYaw(0.0, 0.0, 0.0, 0.0))
        )
        rate, step, rows = 0.3, 0.1 * self.factor, []
        rows += [((0.0, 0.0, -1.5 * t), (0.0, 0.0, -1.5)) for t in times(10.0 / 1.5, step)]
        rows += [((0.0, 0.0, -10.0), (0.0, 0.0, 0.0)) for _ in times(4.0, step)]
        for t in times(2.0 * math.pi / rate, step):
            sine, cosine = math.sin(rate * t), math.cos(rate * t)
            place = (10.0 * sine, 10.0 - 10.0 * cosine, -10.0)
            rows.append((place, (3.0 * cosine, 3.0 * sine, 0.0)))
        for place, along in rows:
            await offboard.set_position_velocity_ned(
                module.PositionNedYaw(*place, 0.0), module.VelocityNedYaw(*along, 0.0)
            )
            await asyncio.sleep(0.1)
        await offboard.set_position_ned(module.PositionNedYaw(0.0, 0.0, -10.0, 0.0))
        await self.at(0.0, 0.0, -10.0)
        await self.drone.action.land()
        await self.disarmed()

    async def do_orbit(self) -> None:
        """Once round a place, 10 m away from it at 2 m/s, in ORBIT."""
        drone, up = self.drone, 10.0 + 6.0 * self.vehicle
        await self.take_off()
        latitude, longitude = self.place(33.0, -44.0)
        looks = part("action").OrbitYawBehavior.HOLD_FRONT_TO_CIRCLE_CENTER
        altitude = self.home.absolute_altitude_m + up
        await drone.action.do_orbit(10.0, 2.0, looks, latitude, longitude, altitude)
        scale = math.cos(math.radians(latitude))

        def away(here: Any) -> float:
            north, east = here.latitude_deg - latitude, (here.longitude_deg - longitude) * scale
            return METRES_PER_DEG * math.hypot(north, east)

        await first(drone.telemetry.position(), lambda here: abs(away(here) - 10.0) < 2.0)
        for sign in (1.0, -1.0):
            await first(
                drone.telemetry.position_velocity_ned(), lambda now, sign=sign: sign * now.velocity.north_m_s > 1.0
            )
        assert abs(away(await first(drone.telemetry.position())) - 10.0) < 3.0
        await self.home_again()

    async def follow_me(self) -> None:
        """Behind a target that is told at three places."""
        drone, module, mode = self.drone, part("follow_me"), part("telemetry").FlightMode
        kind = module.Config.FollowAltitudeMode.CONSTANT
        # Height, distance, responsiveness, kind of altitude, largest speed round the target, angle.
        await drone.follow_me.set_config(module.Config(8.0 + 6.0 * self.vehicle, 2.0, 0.02, kind, 8.0, 180.0))
        await self.take_off()
        await drone.follow_me.start()
        await first(drone.telemetry.flight_mode(), lambda now: now is mode.FOLLOW_ME)
        for north, east in ((33.0, 0.0), (33.0, -44.0), (9.0, -44.0)):
            latitude, longitude = self.place(north, east)
            target = module.TargetLocation(latitude, longitude, 0.0, 0.0, 0.0, 0.0)
            told = asyncio.create_task(self.repeat(lambda target=target: drone.follow_me.set_target_location(target)))
            await first(
                drone.telemetry.position(),
                lambda here, latitude=latitude: abs(here.latitude_deg - latitude) * METRES_PER_DEG < 5.0,
            )
            told.cancel()
        await drone.follow_me.stop()
        await first(drone.telemetry.flight_mode(), lambda now: now is mode.HOLD)
        await self.home_again()

    async def repeat(self, call: Callable[[], Awaitable[None]]) -> None:
        """Call something ten times a second until this is cancelled."""
        while True:
            await call()
            await asyncio.sleep(0.1)

    async def geofence(self) -> None:
        """A square of 22 m by 15 m goes up; who flies out of it holds; it is cleared."""
        module, drone = part("geofence"), self.drone
        latitude, longitude = self.home.latitude_deg, self.home.longitude_deg
        corners = [
            module.Point(latitude + x, longitude + y)
            for x, y in ((-1e-4, -1e-4), (1e-4, -1e-4), (1e-4, 1e-4), (-1e-4, 1e-4))
        ]
        polygon = module.Polygon(corners, module.FenceType.INCLUSION)
        await drone.geofence.upload_geofence(module.GeofenceData([polygon], []))
        await self.take_off(5.0)
        try:
            await drone.action.goto_location(*self.place(40.0, 0.0), self.home.absolute_altitude_m + 5.0, 0.0)
            raise SystemExit("a place outside the fence was taken")
        except part("action").ActionError as refused:
            print(f"outside: {refused}")
        await drone.action.land()
        await self.disarmed()
        await drone.geofence.clear_geofence()

    async def failure_injection(self) -> None:
        """The parameter is there, the failure is answered, and the flight goes on."""
        module, drone = part("failure"), self.drone
        await drone.param.set_param_int("SYS_FAILURE_EN", 1)
        await self.take_off(8.0)
        try:
            await drone.failure.inject(module.FailureUnit.SENSOR_GPS, module.FailureType.OFF, instance=0)
        except module.FailureError as said:
            print(f"failure: {said}")
        await self.wait(5.0)
        await self.at(0.0, 0.0, -8.0, near=3.0)
        await drone.param.set_param_int("SYS_FAILURE_EN", 0)
        await self.home_again()

    async def failures(self) -> None:
        """A receiver that is off has no fix, forbids to arm, and comes back."""
        module, drone = part("failure"), self.drone
        gps, off, ok = module.FailureUnit.SENSOR_GPS, module.FailureType.OFF, module.FailureType.OK
        # MAVSDK 3 and 4 read it when the plug-in is first used, and not again.
        await drone.param.set_param_int("SYS_FAILURE_EN", 1)
        assert await self.answer(module.FailureUnit.SYSTEM_SERVO, off) == "UNSUPPORTED"
        await first(drone.telemetry.gps_info(), lambda now: str(now.fix_type) == "FIX_3D")
        assert await self.answer(gps, off) == "SUCCESS"
        await first(drone.telemetry.gps_info(), lambda now: str(now.fix_type) in ("NO_GPS", "NO_FIX"))
        try:
            await drone.action.arm()
        except part("action").ActionError as error:
            print(f"arming: {error}")
        else:
            raise AssertionError("armed without a fix")
        assert await self.answer(gps, ok) == "SUCCESS"
        await first(drone.telemetry.gps_info(), lambda now: str(now.fix_type) == "FIX_3D")
        await drone.param.set_param_int("SYS_FAILURE_EN", 0)

    async def no_failures(self) -> None:
        """Without SYS_FAILURE_EN the plug-in says DISABLED; before it has read that, the vehicle DENIED."""
        module = part("failure")
        gps, off = module.FailureUnit.SENSOR_GPS, module.FailureType.OFF
        await self.drone.param.set_param_int("SYS_FAILURE_EN", 0)
        assert await self.answer(gps, off) in ("DENIED", "DISABLED")
        await asyncio.sleep(2.0)
        assert await self.answer(gps, off) == "DISABLED"
        assert str((await first(self.drone.telemetry.gps_info())).fix_type) == "FIX_3D"

    async def answer(self, unit: Any, kind: Any) -> str:
        """Inject a failure, and return the result."""
        try:
            await self.drone.failure.inject(unit, kind, instance=0)
        except part("failure").FailureError as error:
            return str(error._result.result)
        return "SUCCESS"

    async def telemetry(self) -> None:
        """Every stream of the telemetry examples says something that makes sense."""
        found = self.drone.telemetry
        assert (await first(found.battery())).remaining_percent > 0.5
        assert (await first(found.gps_info())).num_satellites > 5
        assert not await first(found.in_air())
        assert abs((await first(found.position())).latitude_deg - 47.4) < 0.1
        assert str(await first(found.flight_mode())) == "HOLD"
        assert abs((await first(found.attitude_euler())).roll_deg) < 5.0
        assert not await first(found.armed())
        assert await first(found.health_all_ok(), bool)

    async def params(self) -> None:
        """All parameters, one of each type set and read back, and the version."""
        drone = self.drone
        listed = await drone.param.get_all_params()
        names = {one.name for one in [*listed.int_params, *listed.float_params]}
        assert {"MAV_SYS_ID", "MPC_XY_CRUISE", "GF_ACTION"} <= names, names
        await drone.param.set_param_int("GF_ACTION", 1)
        await drone.param.set_param_float("MPC_XY_CRUISE", 6.5)
        assert await drone.param.get_param_int("GF_ACTION") == 1
        assert await drone.param.get_param_float("MPC_XY_CRUISE") == 6.5
        await drone.param.set_param_int("GF_ACTION", 2)
        assert (await drone.info.get_version()).flight_sw_major >= 1

    async def manual_control(self) -> None:
        """Sticks of all kinds for some seconds after a take-off, in POSCTL; then home."""
        drone, module = self.drone, part("telemetry")
        await drone.manual_control.set_manual_control_input(0.0, 0.0, 0.5, 0.0)
        await self.take_off(6.0)
        await drone.manual_control.set_manual_control_input(0.0, 0.0, 0.5, 0.0)
        await drone.manual_control.start_position_control()
        await first(drone.telemetry.flight_mode(), lambda now: now is module.FlightMode.POSCTL)
        for sticks in (
            (-1.0, 0.0, 0.5, 0.0), (1.0, 0.0, 0.5, 0.0), (0.0, -1.0, 0.5, 0.0), (0.0, 1.0, 0.5, 0.0),
            (0.0, 0.0, 0.5, 1.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.5, 0.0),
        ):  # fmt: skip
            for _ in range(10):
                await drone.manual_control.set_manual_control_input(*sticks)
                await asyncio.sleep(0.1 / self.factor)
        assert await first(drone.telemetry.in_air())
        await self.home_again()


def times(end: float, step: float) -> list[float]:
    """Return times from 0 to before an end [s]."""
    return [number * step for number in range(math.ceil(end / step))]


async def first(stream: AsyncIterator[Any], holds: Callable[[Any], bool] = lambda found: True) -> Any:
    """Return the first of a stream for which something holds."""
    async for found in stream:
        if holds(found):
            return found
    raise SystemExit("the stream has ended")


async def main(script: str, address: str, port: int, vehicle: int, factor: float) -> None:
    """Fly one script."""
    flight = Flight(port, vehicle, factor)
    await flight.connect(address)
    await getattr(flight, script)()
    print(f"flown: {script}", flush=True)


if __name__ == "__main__":
    script, address, *more = sys.argv[1:]
    port, vehicle, factor = [*more, *("50051", "0", "1")[len(more) :]]
    try:
        flight = main(script, address, int(port), int(vehicle), float(factor))
        asyncio.run(asyncio.wait_for(flight, PATIENCE))
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        # A thread of MAVSDK reads from its server for ever.
        os._exit(1)
