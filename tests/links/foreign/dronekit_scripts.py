"""What DroneKit's examples do, one flight each: ``python dronekit_scripts.py SCRIPT ADDRESS [VEHICLE]``.

Needs ``pip install dronekit2``, and ``qrsim mavlink --flavour ardupilot``. VEHICLE, from 0, keeps those apart that fly
the same script at once: places are 6 m higher for each.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import Any

from dronekit import Command, LocationGlobalRelative, VehicleMode, connect
from pymavlink import mavutil

M = mavutil.mavlink
PATIENCE = 120.0
METRES_PER_DEG = 111_200.0
NEAR = 1.5


def until(holds: Callable[[], bool], repeat: Callable[[], None] | None = None, every: float = 0.2) -> None:
    """Wait until something holds; ``repeat`` is called meanwhile."""
    end, again = time.monotonic() + PATIENCE, -math.inf
    while not holds():
        now = time.monotonic()
        if now > end:
            raise SystemExit(f"not in time: line {holds.__code__.co_firstlineno}")
        if repeat is not None and now - again > every:
            again = now
            repeat()
        time.sleep(0.02)


class Flight:
    """One vehicle and its script."""

    def __init__(self, address: str, vehicle: int) -> None:
        self.vehicle: Any = connect(address, wait_ready=True, rate=10)
        self.up = 10.0 + 6.0 * vehicle
        self.home: Any = None

    def mode(self, name: str) -> None:
        """Change the mode."""
        self.vehicle.mode = VehicleMode(name)
        until(lambda: bool(self.vehicle.mode.name == name))

    def height(self) -> float:
        """Return the height over home [m]."""
        return float(self.vehicle.location.global_relative_frame.alt)

    def download(self) -> Any:
        """Download the mission, with home as its first item."""
        commands = self.vehicle.commands
        commands.download()
        commands.wait_ready()
        self.home = self.vehicle.home_location
        return commands

    def take_off(self, mode: str = "GUIDED", height: float = 8.0) -> None:
        """Arm and take off."""
        until(lambda: bool(self.vehicle.is_armable))
        self.download()
        self.mode(mode)
        self.vehicle.armed = True
        until(lambda: bool(self.vehicle.armed))
        if mode == "GUIDED":
            self.vehicle.simple_takeoff(height)
            until(lambda: self.height() > 0.95 * height)

    def place(self, north: float, east: float, up: float | None = None) -> Any:
        """Return a place, so many metres from home."""
        scale = METRES_PER_DEG * math.cos(math.radians(self.home.lat))
        up = self.up if up is None else up
        return LocationGlobalRelative(self.home.lat + north / METRES_PER_DEG, self.home.lon + east / scale, up)

    def away(self, place: Any) -> float:
        """Return the distance to a place [m]."""
        here = self.vehicle.location.global_relative_frame
        north, east = (here.lat - place.lat) * METRES_PER_DEG, (here.lon - place.lon) * METRES_PER_DEG
        return math.hypot(north, east * math.cos(math.radians(place.lat)), here.alt - place.alt)

    def land(self, mode: str = "RTL") -> None:
        """Return or land, until it is disarmed."""
        self.vehicle.parameters["RTL_RETURN_ALT"] = self.up
        self.mode(mode)
        until(lambda: not self.vehicle.armed)

    # ---- the scripts ----

    def simple_goto(self) -> None:
        """To two places, one after the other, at a speed."""
        self.take_off()
        self.vehicle.airspeed = 3
        for place, more in ((self.place(20.0, 0.0), {}), (self.place(20.0, -25.0), {"groundspeed": 8.0})):
            self.vehicle.simple_goto(place, **more)
            until(lambda place=place: self.away(place) < NEAR)
        self.land()

    def mission_basic(self) -> None:
        """A square with a take-off before it; from item 3 on with item 5."""
        self.download()
        commands = self.vehicle.commands
        commands.clear()
        frame = M.MAV_FRAME_GLOBAL_RELATIVE_ALT
        commands.add(Command(0, 0, 0, frame, M.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 0, 10))
        for north, east in ((20.0, -20.0), (20.0, 20.0), (-20.0, 20.0), (-20.0, -20.0), (-20.0, -20.0)):
            place = self.place(north, east)
            commands.add(
                Command(0, 0, 0, frame, M.MAV_CMD_NAV_WAYPOINT, 0, 0, 0, 0, 0, 0, place.lat, place.lon, place.alt)
            )
        commands.upload(timeout=PATIENCE)
        self.take_off()
        self.vehicle.commands.next = 0
        self.mode("AUTO")
        until(lambda: self.vehicle.commands.next == 3)
        self.vehicle.commands.next = 5
        until(lambda: self.vehicle.commands.next == 5)
        self.land()

    def guided_set_speed_yaw(self) -> None:
        """Set-points of all kinds, a heading, a speed, and a point to look at that is no more than answered."""
        self.take_off()
        send, factory = self.vehicle.send_mavlink, self.vehicle.message_factory

        def command(number: int, *params: float) -> None:
            send(factory.command_long_encode(0, 0, number, 0, *params, *[0.0] * (7 - len(params))))

        def local(mask: int, *numbers: float, frame: int = M.MAV_FRAME_LOCAL_NED) -> None:
            send(factory.set_position_target_local_ned_encode(0, 0, 0, frame, mask, *numbers, 0, 0, 0, 0, 0))

        command(M.MAV_CMD_DO_CHANGE_SPEED, 0.0, 4.0)
        down = -self.height()
        for north, east in ((8.0, 0.0), (8.0, -8.0)):
            local(0xFF8, north, east, down, 0.0, 0.0, 0.0)
            until(
                lambda north=north, east=east: (
                    math.hypot(
                        self.vehicle.location.local_frame.north - north, self.vehicle.location.local_frame.east - east
                    )
                    < NEAR
                )
            )
        place = self.place(0.0, -8.0, 8.0)
        send(
            factory.set_position_target_global_int_encode(
                0, 0, 0, M.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 0xFF8, int(place.lat * 1e7), int(place.lon * 1e7),
                place.alt, 0, 0, 0, 0, 0, 0, 0, 0,
            )
        )  # fmt: skip
        until(lambda: self.away(place) < NEAR)
        command(M.MAV_CMD_CONDITION_YAW, 80.0, 0.0, 1.0, 0.0)
        until(lambda: abs(self.vehicle.heading - 80) < 8)
        command(M.MAV_CMD_DO_SET_ROI, 0.0, 0.0, 0.0, 0.0, place.lat, place.lon, place.alt)
        # Along the heading, which is about east: DroneKit's velocities are of MAV_FRAME_BODY_NED.
        until(
            lambda: self.vehicle.velocity[1] > 1.5,
            lambda: local(0xFC7, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, frame=M.MAV_FRAME_BODY_NED),
        )
        self.land()

    def set_attitude_target(self) -> None:
        """Up, ahead and back by attitudes in GUIDED_NOGPS, where a thrust of 0.5 holds the height; then LAND.

        The example names system 1, and is to be changed for other vehicles.
        """
        self.take_off("GUIDED_NOGPS")

        def lean(pitch: float, thrust: float) -> Callable[[], None]:
            half = math.radians(0.5 * pitch)
            q = [math.cos(half), 0.0, math.sin(half), 0.0]
            message = self.vehicle.message_factory.set_attitude_target_encode(0, 0, 0, 0b00000100, q, 0, 0, 0, thrust)
            return lambda: self.vehicle.send_mavlink(message)

        until(lambda: self.height() > 0.95 * 2.5, lean(0.0, 0.7))
        # For a while, as the example does: it drifts with the wind.
        for pitch in (0.0, -5.0, 5.0):
            begin = time.monotonic()
            until(lambda begin=begin: time.monotonic() - begin > 0.7, lean(pitch, 0.5), 0.1)
            assert 1.0 < self.height() < 6.0, self.height()
        self.land("LAND")

    def vehicle_state(self) -> None:
        """All attributes, another home, modes, listeners and parameters, without a flight."""
        vehicle = self.vehicle
        vehicle.wait_ready("autopilot_version")
        assert vehicle.version.major >= 4
        assert vehicle.capabilities.set_attitude_target
        assert vehicle.gps_0.fix_type >= 3
        assert vehicle.battery is not None
        assert abs(vehicle.location.global_frame.lat - 47.4) < 0.1
        until(lambda: bool(vehicle.is_armable))
        assert vehicle.ekf_ok
        self.download()
        place = vehicle.location.global_frame
        place.alt = 222.0
        vehicle.home_location = place
        until(lambda: self.download() is not None and abs(self.home.alt - 222.0) < 0.1)
        self.mode("GUIDED")
        attitudes: list[Any] = []
        vehicle.add_attribute_listener("attitude", lambda _, name, value: attitudes.append(value))
        until(lambda: len(attitudes) > 3)
        self.mode("STABILIZE")
        # Neither ArduPilot's Copter of today nor this one has it: DroneKit asks three times, and sets nothing.
        assert vehicle.parameters.get("THR_MIN", wait_ready=False) is None
        assert len(list(vehicle.parameters.items())) > 40
        vehicle.parameters["MPC_THR_HOVER"] = 0.4
        until(lambda: abs(vehicle.parameters["MPC_THR_HOVER"] - 0.4) < 1e-6)
        vehicle.parameters["MPC_THR_HOVER"] = 0.5

    def follow_me(self) -> None:
        """To where somebody is, told every 2 s as a place of simple_goto."""
        self.take_off()
        began = time.monotonic()

        def somebody() -> Any:
            return self.place(3.0 * (time.monotonic() - began), 0.0)

        until(lambda: self.vehicle.location.local_frame.north > 15.0, lambda: self.vehicle.simple_goto(somebody()), 0.5)
        self.land()

    def channel_overrides(self) -> None:
        """Sticks by RC_CHANNELS_OVERRIDE in POSHOLD, and none of them again."""
        self.take_off()
        self.vehicle.channels.overrides = {"1": 1500, "2": 1500, "3": 1500, "4": 1500}
        time.sleep(0.3)
        self.mode("POSHOLD")
        sticks = {"1": 1500, "2": 1300, "3": 1500, "4": 1500}

        def push() -> None:
            self.vehicle.channels.overrides = dict(sticks)

        until(lambda: self.vehicle.velocity[0] ** 2 + self.vehicle.velocity[1] ** 2 > 1.0, push)
        self.vehicle.channels.overrides = {}
        self.land()


if __name__ == "__main__":
    script, address, *more = sys.argv[1:]
    flight = Flight(address, int(more[0]) if more else 0)
    getattr(flight, script)()
    print(f"flown: {script}", flush=True)
    flight.vehicle.close()
