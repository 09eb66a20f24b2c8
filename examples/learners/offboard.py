"""Keep a spot by a learned policy, through MAVLink: offboard.py POLICY.npz [ADDRESS], after ``qrsim mavlink``.

The policy is one of ``qrsim train keep_spot`` whose actions are velocities (docs/howto/train.md). Needs pymavlink.
"""

import json
import os
import sys

import numpy as np

from qrsim.tasks.learned import read_policy

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

M = mavutil.mavlink
# PX4's mode, the type mask of a velocity, an action of 1 [m/s], and the flight's length on the vehicle's clock [s].
HOLD, VELOCITY_ONLY, FASTEST, SECONDS = 4 << 16 | 3 << 24, 0x9C7, 3.0, 30.0
if len(sys.argv) < 2:
    raise SystemExit(__doc__)
policy, address = sys.argv[1], (*sys.argv[2:], "udpin:127.0.0.1:14540")[0]
file = read_policy(policy)
if file.view.acts != ("velocity_north", "velocity_east", "velocity_down"):
    raise SystemExit(f"{policy}: its actions are {', '.join(file.view.acts)}; train it with task.actions=velocity")
link = mavutil.mavlink_connection(address, source_system=245)


def wait(kind, holds=lambda message: True):
    """Return the next message of a kind for which something holds."""
    while (found := link.recv_match(type=kind, blocking=True, timeout=120.0)) is not None:
        if found.get_srcSystem() == link.target_system and holds(found):
            return found
    raise SystemExit(f"{address}: no {kind} in time; is 'qrsim mavlink' running?")


def command(number, *params):
    """Send a command, which has to be accepted."""
    link.mav.command_long_send(link.target_system, 1, number, 0, *params, *[np.nan] * (7 - len(params)))
    if wait("COMMAND_ACK", lambda ack: ack.command == number).result != M.MAV_RESULT_ACCEPTED:
        raise SystemExit(f"{M.enums['MAV_CMD'][number].name} was refused")


link.wait_heartbeat(timeout=120.0)
wait("SYS_STATUS", lambda status: status.onboard_control_sensors_health & M.MAV_SYS_STATUS_PREARM_CHECK)
height = wait("HOME_POSITION").altitude * 1e-3 + 10.0
command(M.MAV_CMD_COMPONENT_ARM_DISARM, 1)
command(M.MAV_CMD_NAV_TAKEOFF, *[np.nan] * 6, height)
wait("HEARTBEAT", lambda beat: beat.custom_mode == HOLD)
pilot, here, acted, distances = file.pilot(1, file.view.seconds), wait("LOCAL_POSITION_NED"), -np.inf, []
goal, end = np.array([here.x + 2.0, here.y, here.z]), here.time_boot_ms * 1e-3 + SECONDS
while (now := here.time_boot_ms * 1e-3) < end:
    if now - acted > 0.99 * file.view.seconds:
        place, turned = np.array([here.x, here.y, here.z]), wait("ATTITUDE")
        seen = [*place, here.vx, here.vy, here.vz, turned.roll, turned.pitch, turned.yaw, *(goal - place)]
        velocity = map(float, FASTEST * pilot.act(np.array([seen], np.float32))[0])
        target = 0, link.target_system, 1, M.MAV_FRAME_LOCAL_NED, VELOCITY_ONLY
        link.mav.set_position_target_local_ned_send(*target, 0, 0, 0, *velocity, 0, 0, 0, 0, 0)
        if not distances:
            command(M.MAV_CMD_DO_SET_MODE, 1, 6)  # OFFBOARD
        acted, distances = now, [*distances, float(np.linalg.norm(goal - place))]
    here = wait("LOCAL_POSITION_NED")
print(json.dumps({"decisions": len(distances), "mean_distance_m": np.mean(distances[len(distances) // 2 :])}))
command(M.MAV_CMD_NAV_LAND)
