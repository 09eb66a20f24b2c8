"""Fly a vehicle of ``qrsim mavlink`` by pymavlink: up, to a place, a mission, by set-points, home, down.

    qrsim mavlink &
    python examples/pymavlink_flight.py                      # or: ... tcp:127.0.0.1:5760, after qrsim mavlink --tcp

Needs ``pip install pymavlink``. The same script flies PX4's own simulation.
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
NAN = math.nan
# Longest that a step may take by the wall clock [s].
PATIENCE = 120.0
# custom_mode of PX4: main mode << 16, sub mode << 24.
HOLD, OFFBOARD = 4 << 16 | 3 << 24, 6 << 16
# A place may be missed by so much [m]: the vehicle knows its own only as well as its GNSS.
NEAR = 1.5
POSITION_ONLY, VELOCITY_ONLY = 0x9F8, 0x9C7


class Vehicle:
    """A connection to one vehicle."""

    def __init__(self, address: str):
        self.link = mavutil.mavlink_connection(address, source_system=245)
        self.link.wait_heartbeat(timeout=PATIENCE)
        self.ids = self.link.target_system, M.MAV_COMP_ID_AUTOPILOT1
        self.beaten = 0.0

    def until(
        self, kind: str, holds: Callable[[Any], bool], what: str, repeat: Callable[[], None] | None = None
    ) -> Any:
        """Wait for a message for which something holds; ``repeat`` is called 20 times a second meanwhile."""
        end, again = time.monotonic() + PATIENCE, 0.0
        while time.monotonic() < end:
            if time.monotonic() - self.beaten > 1.0:
                self.beaten = time.monotonic()
                self.link.mav.heartbeat_send(M.MAV_TYPE_GCS, M.MAV_AUTOPILOT_INVALID, 0, 0, 0)
            if repeat is not None and time.monotonic() - again > 0.05:
                again = time.monotonic()
                repeat()
            message = self.link.recv_match(type=[kind, "STATUSTEXT"], blocking=True, timeout=0.05)
            if message is None or message.get_srcSystem() != self.ids[0]:
                continue
            if message.get_type() == "STATUSTEXT":
                print(f"  vehicle: {message.text}")
            if message.get_type() == kind and holds(message):
                print(what, flush=True)
                return message
        raise SystemExit(f"not in time: {what}")

    def command(self, number: int, *params: float) -> None:
        """Send a command, which has to be accepted; what is not given is not set."""
        self.link.mav.command_long_send(*self.ids, number, 0, *params, *[NAN] * (7 - len(params)))
        name = M.enums["MAV_CMD"][number].name
        ack = self.until("COMMAND_ACK", lambda message: message.command == number, f"{name} answered")
        if ack.result != M.MAV_RESULT_ACCEPTED:
            raise SystemExit(f"{name}: {M.enums['MAV_RESULT'][ack.result].name}")

    def mode(self, custom: int, what: str) -> None:
        """Wait for a mode."""
        self.until("HEARTBEAT", lambda beat: beat.custom_mode == custom, what)

    def place(self) -> Any:
        """Return LOCAL_POSITION_NED."""
        return self.until("LOCAL_POSITION_NED", lambda message: True, "place known")

    def goto(self, latitude: float, longitude: float, altitude: float) -> None:
        """Fly to a place [deg, deg, m above mean sea level]."""
        place = round(latitude * 1e7), round(longitude * 1e7)
        self.link.mav.command_int_send(
            *self.ids, M.MAV_FRAME_GLOBAL, M.MAV_CMD_DO_REPOSITION, 0, 0, -1.0, 1.0, 0.0, NAN, *place, altitude
        )
        self.until(
            "GLOBAL_POSITION_INT",
            lambda here: (
                math.hypot(here.lat - place[0], 0.68 * (here.lon - place[1])) * 0.0111 < NEAR
                and abs(here.alt * 1e-3 - altitude) < NEAR
            ),
            "there",
        )

    def upload(self, items: list[tuple[float, ...]]) -> None:
        """Upload a mission of (command, frame, four parameters, latitude, longitude, height)."""
        self.link.mav.mission_count_send(*self.ids, len(items), M.MAV_MISSION_TYPE_MISSION)
        while True:
            asked = self.link.recv_match(type=["MISSION_REQUEST_INT", "MISSION_ACK"], blocking=True, timeout=PATIENCE)
            if asked is None:
                raise SystemExit("not in time: mission")
            if asked.get_type() == "MISSION_ACK":
                if asked.type != M.MAV_MISSION_ACCEPTED:
                    raise SystemExit(f"mission: {M.enums['MAV_MISSION_RESULT'][asked.type].name}")
                print(f"mission of {len(items)} items uploaded")
                return
            command, frame, *params, latitude, longitude, height = items[asked.seq]
            self.link.mav.mission_item_int_send(
                *self.ids,
                asked.seq,
                int(frame),
                int(command),
                0,
                1,
                *params,
                round(latitude * 1e7),
                round(longitude * 1e7),
                height,
                M.MAV_MISSION_TYPE_MISSION,
            )

    def setpoint(
        self, mask: int, position: tuple[float, ...] = (0, 0, 0), velocity: tuple[float, ...] = (0, 0, 0)
    ) -> None:
        """Send a set-point in NED."""
        self.link.mav.set_position_target_local_ned_send(
            0, *self.ids, M.MAV_FRAME_LOCAL_NED, mask, *position, *velocity, 0, 0, 0, 0, 0
        )


def main(address: str) -> None:
    """Fly."""
    v = Vehicle(address)
    print(f"system {v.ids[0]}")
    v.until("SYS_STATUS", lambda s: s.onboard_control_sensors_health & M.MAV_SYS_STATUS_PREARM_CHECK, "may be armed")
    home = v.until("HOME_POSITION", lambda message: True, "home known")
    latitude, longitude, ground = home.latitude * 1e-7, home.longitude * 1e-7, home.altitude * 1e-3
    v.link.mav.param_set_send(*v.ids, b"RTL_RETURN_ALT", 15.0, M.MAV_PARAM_TYPE_REAL32)
    v.until("PARAM_VALUE", lambda p: p.param_id == "RTL_RETURN_ALT" and p.param_value == 15.0, "RTL_RETURN_ALT is 15 m")

    v.command(M.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    v.command(M.MAV_CMD_NAV_TAKEOFF, NAN, NAN, NAN, NAN, NAN, NAN, ground + 8.0)
    v.mode(HOLD, "took off")
    v.goto(latitude + 2e-4, longitude, ground + 10.0)

    relative = M.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
    corners = [(2e-4, 2e-4), (1e-4, 3e-4), (0.0, 2e-4), (0.0, 1e-4), (1e-4, 1e-4)]
    v.upload(
        [
            (M.MAV_CMD_NAV_WAYPOINT, relative, 1.0, 2.0, 0.0, NAN, latitude + north, longitude + east, 10.0 + number)
            for number, (north, east) in enumerate(corners)
        ]
    )
    v.command(M.MAV_CMD_MISSION_START, 0, 0)
    for number in range(len(corners)):
        v.until("MISSION_ITEM_REACHED", lambda item, seq=number: item.seq == seq, f"item {number} reached")
    v.mode(HOLD, "mission flown")

    here = v.place()
    goal = (here.x + 8.0, here.y, here.z)
    send = lambda: v.setpoint(POSITION_ONLY, position=goal)  # noqa: E731
    send()
    v.command(M.MAV_CMD_DO_SET_MODE, 1, 6)
    near = lambda now: math.dist((now.x, now.y, now.z), goal) < NEAR  # noqa: E731
    v.until("LOCAL_POSITION_NED", near, "at the position of the set-point", send)
    east = lambda: v.setpoint(VELOCITY_ONLY, velocity=(0.0, 2.0, 0.0))  # noqa: E731
    v.until("LOCAL_POSITION_NED", lambda now: now.y > goal[1] + 8.0 and now.vy > 1.5, "flies by velocity", east)

    v.command(M.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    v.until("EXTENDED_SYS_STATE", lambda state: state.landed_state == M.MAV_LANDED_STATE_ON_GROUND, "landed")
    v.until("HEARTBEAT", lambda beat: not beat.base_mode & M.MAV_MODE_FLAG_SAFETY_ARMED, "disarmed")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "udpin:127.0.0.1:14540")
