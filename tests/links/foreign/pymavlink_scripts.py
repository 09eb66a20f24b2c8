"""What scripts with pymavlink alone do: ``python pymavlink_scripts.py SCRIPT ADDRESS [VEHICLE]``.

``guided`` is ArduPilot's page of GUIDED commands, for ``--flavour ardupilot``; ``swarm`` is one process for each
vehicle of a swarm, which rises in steps, shifts together and comes home, for PX4's flavour.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable
from typing import Any

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

M = mavutil.mavlink
PATIENCE = 120.0
NAN = math.nan
PLACE, VELOCITY, ANGLES = 0xDF8, 0xDC7, 0x07
GUIDED, RTL = 4, 6


class Client:
    """One vehicle and its script."""

    def __init__(self, address: str, vehicle: int) -> None:
        self.link = mavutil.mavlink_connection(address, source_system=245)
        self.vehicle = vehicle
        beat = self.link.wait_heartbeat(timeout=PATIENCE)
        assert beat is not None
        self.to = (self.link.target_system, self.link.target_component)
        self.mav = self.link.mav

    def until(self, kind: str, holds: Callable[[Any], bool], repeat: Callable[[], None] = lambda: None) -> Any:
        """Wait for a message for which something holds; ``repeat`` is called ten times a second meanwhile."""
        end, again = time.monotonic() + PATIENCE, 0.0
        while time.monotonic() < end:
            if time.monotonic() - again > 0.1:
                again = time.monotonic()
                repeat()
            found = self.link.recv_match(type=kind, blocking=True, timeout=0.05)
            if found is not None and holds(found):
                return found
        raise SystemExit(f"no such {kind}: line {holds.__code__.co_firstlineno}")

    def command(self, number: int, *params: float) -> int:
        """Send a command, and return its result."""
        self.mav.command_long_send(*self.to, number, 0, *params, *[NAN] * (7 - len(params)))
        return int(self.until("COMMAND_ACK", lambda ack: ack.command == number).result)

    def ready(self) -> None:
        """Wait until it may be armed."""
        self.until("SYS_STATUS", lambda s: s.onboard_control_sensors_health & M.MAV_SYS_STATUS_PREARM_CHECK)

    def local(self, mask: int, *numbers: float, frame: int = M.MAV_FRAME_LOCAL_NED, yaw: float = 0.0) -> None:
        """Send a set-point: position, velocity."""
        self.mav.set_position_target_local_ned_send(0, *self.to, frame, mask, *numbers, 0, 0, 0, yaw, 0)

    def at(self, north: float, east: float, down: float, repeat: Callable[[], None] = lambda: None) -> None:
        """Wait until it is at a place of its local frame."""
        there = (north, east, down)
        self.until("LOCAL_POSITION_NED", lambda here: math.dist((here.x, here.y, here.z), there) < 1.0, repeat)

    def disarmed(self) -> None:
        """Wait until it is disarmed."""
        self.until("HEARTBEAT", lambda beat: not beat.base_mode & M.MAV_MODE_FLAG_SAFETY_ARMED)

    # ---- the scripts ----

    def guided(self) -> None:
        """Take-off, places, velocities and attitudes in GUIDED, and home."""
        self.ready()
        self.mav.set_mode_send(self.to[0], M.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, GUIDED)
        self.until("HEARTBEAT", lambda beat: beat.custom_mode == GUIDED)
        assert self.command(M.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
        assert self.command(M.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 10) == 0
        self.until("GLOBAL_POSITION_INT", lambda here: here.relative_alt > 9500)
        down = self.until("LOCAL_POSITION_NED", lambda here: True).z
        # Each is said once.
        self.local(PLACE, 8.0, 0.0, down, 0.0, 0.0, 0.0)
        self.at(8.0, 0.0, down)
        self.local(PLACE, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0, frame=M.MAV_FRAME_LOCAL_OFFSET_NED)
        self.at(13.0, 0.0, down)
        home = self.until("HOME_POSITION", lambda here: True)
        self.mav.set_position_target_global_int_send(
            0, *self.to, M.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, PLACE, home.latitude, home.longitude, 12.0, 0, 0, 0, 0, 0,
            0, 0, 0,
        )  # fmt: skip
        self.until(
            "GLOBAL_POSITION_INT", lambda here: abs(here.lat - home.latitude) < 100 and here.relative_alt > 11000
        )
        self.local(0x9C7, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, yaw=math.radians(90.0))
        self.until(
            "ATTITUDE",
            lambda now: abs(now.yaw - math.pi / 2) < 0.1,
            lambda: self.local(0x9C7, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, yaw=math.radians(90.0)),
        )
        ahead = lambda: self.local(VELOCITY, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, frame=M.MAV_FRAME_BODY_OFFSET_NED)  # noqa: E731
        self.until("LOCAL_POSITION_NED", lambda now: now.vy > 1.5, ahead)
        lean = [math.cos(0.05), 0.0, -math.sin(0.05), 0.0]
        self.until(
            "ATTITUDE",
            lambda now: now.pitch < -0.07,
            lambda: self.mav.set_attitude_target_send(0, *self.to, ANGLES, lean, 0, 0, 0, 0.5),
        )
        assert self.command(M.MAV_CMD_CONDITION_YAW, 0.0, 0.0, 1.0, 0.0) == 0
        self.mav.param_set_send(*self.to, b"RTL_RETURN_ALT", 12.0 + 6.0 * self.vehicle, 9)
        self.mav.set_mode_send(self.to[0], M.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, RTL)
        self.disarmed()

    def swarm(self) -> None:
        """Rise to a height of its own, shift by 10 m north and east, back, and down, by set-points in OFFBOARD."""
        self.ready()
        here = self.until("LOCAL_POSITION_NED", lambda now: True)
        # Later it may have flown before, and landed beside its start.
        assert math.hypot(here.x, here.y, here.z) < (1.5 if here.time_boot_ms < 30_000 else 3.0), here
        down = -5.0 - self.vehicle
        begin = lambda: self.local(0x9F8, 0.0, 0.0, down, 0.0, 0.0, 0.0)  # noqa: E731
        begin()
        assert self.command(M.MAV_CMD_DO_SET_MODE, 1, 6) == 0
        assert self.command(M.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
        self.at(0.0, 0.0, down, begin)
        for north, east in ((10.0, 0.0), (10.0, 10.0), (0.0, 10.0), (0.0, 0.0)):
            self.at(
                north,
                east,
                down,
                lambda north=north, east=east: self.local(0x9F8, north, east, down, 0.0, 0.0, 0.0),  # type: ignore[misc]
            )
        # LAND stops where the speed lets it: it is to come down where it started.
        stay = lambda: self.local(0x9F8, 0.0, 0.0, down, 0.0, 0.0, 0.0)  # noqa: E731
        self.until("LOCAL_POSITION_NED", lambda now: math.hypot(now.x, now.y, now.vx, now.vy) < 1.0, stay)
        assert self.command(M.MAV_CMD_NAV_LAND) == 0
        self.disarmed()


if __name__ == "__main__":
    script, address, *more = sys.argv[1:]
    client = Client(address, int(more[0]) if more else 0)
    getattr(client, script)()
    print(f"flown: {script}", flush=True)
