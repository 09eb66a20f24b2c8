"""Commands: COMMAND_LONG and COMMAND_INT of flight, and the answer to each."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import replace

from qrsim.links.mavlink.stack.circling import Orbit
from qrsim.links.mavlink.stack.codes import Result, Severity
from qrsim.links.mavlink.stack.contracts import Command, Home, Triple
from qrsim.links.mavlink.stack.fence import AMSL, GLOBAL, RELATIVE
from qrsim.links.mavlink.stack.flight import Flight
from qrsim.links.mavlink.stack.instances import instances_of
from qrsim.links.mavlink.stack.mission import change_speed, heading
from qrsim.links.mavlink.stack.modes import Mode
from qrsim.links.mavlink.stack.orbits import fits

# Param2 of an arm or disarm command that leaves checks out.
FORCE = 21196.0
REPOSITION = 192
LARGEST_ALTITUDE = 1e5
# What has a vehicle move: return, land, take off, orbit, reposition, start a mission.
_MOVES = frozenset((20, 21, 22, 34, REPOSITION, 300))


def obey(stack: Flight, command: Command) -> Result:
    """Execute or refuse a MAVLink command, by its id, and return the MAV_RESULT."""
    known = _COMMANDS.get(command.id)
    if known is None or _ONLY.get(command.id, stack.flavour.name) != stack.flavour.name:
        return Result.UNSUPPORTED
    if any(map(math.isinf, command.params)):
        stack.craft.say(Severity.WARNING, f"Command {command.id} denied: infinite numbers")
        return Result.DENIED
    if command.id in _MOVES and stack.craft.seen.stopped:
        stack.craft.say(Severity.CRITICAL, f"Command {command.id} rejected: {stack.craft.seen.end}")
        return Result.TEMPORARILY_REJECTED
    return known(stack, command)


def _number(value: float, otherwise: float = 0.0) -> float:
    """Return a command's parameter, or ``otherwise`` if it is NaN (unset)."""
    return otherwise if math.isnan(value) else value


def _arm(stack: Flight, command: Command) -> Result:
    """Obey COMPONENT_ARM_DISARM: arm or disarm; disarming in flight needs the force flag."""
    force = command.params[1] == FORCE
    # Unset is neither, and must not stop motors.
    if math.isnan(command.params[0]):
        return Result.DENIED
    if command.params[0] >= 0.5:
        return stack.arm(force)
    if not stack.armed:
        return Result.ACCEPTED
    if not (force or stack.on_ground):
        stack.craft.say(Severity.CRITICAL, "Disarming denied: not landed")
        return Result.TEMPORARILY_REJECTED
    in_air = not stack.on_ground
    stack.disarm("Killed by external command" if in_air else "Disarmed by external command")
    return Result.ACCEPTED


def _take_off(stack: Flight, command: Command) -> Result:
    """Obey NAV_TAKEOFF: climb to the command's altitude, or MIS_TAKEOFF_ALT above home, as PX4 or ArduPilot does."""
    craft = stack.craft
    if not craft.seen.valid or craft.home is None:
        craft.say(Severity.CRITICAL, "Takeoff rejected: no position")
        return Result.TEMPORARILY_REJECTED
    here, asked = craft.seen.position_ned, command.params[6]
    if abs(asked) > LARGEST_ALTITUDE:
        return Result.DENIED
    default = craft.home_z - stack.parameters["MIS_TAKEOFF_ALT"]
    if stack.flavour.name == "ardupilot":
        if not (stack.armed and stack.guided):
            craft.say(Severity.CRITICAL, "Takeoff rejected: arm in GUIDED first")
            return Result.FAILED
        z = craft.home_z - asked if math.isfinite(asked) else default
    else:
        z = _z_of(stack, command) if math.isfinite(asked) else default
    if z > here[2] - 0.3:
        if craft.flies:
            craft.say(Severity.WARNING, "Already higher than takeoff altitude")
        else:
            craft.say(Severity.WARNING, f"Takeoff altitude is below me: {asked:.1f} m; using MIS_TAKEOFF_ALT")
        z = here[2] if craft.flies else min(default, here[2] - 0.5)
    if z < craft.facts.z_min:
        craft.say(Severity.CRITICAL, "Takeoff rejected: above the ceiling of the area")
        return Result.DENIED
    craft.turn_to(math.radians(command.params[3]) if math.isfinite(command.params[3]) else craft.seen.attitude[2])
    stack.switch(Mode.TAKEOFF, goal=(here[0], here[1], z))
    return Result.ACCEPTED


def _z_of(stack: Flight, command: Command) -> float:
    """Return the NED z coordinate [m] of a command's altitude, which is above sea level, home or ground by the
    command's frame."""
    craft, altitude = stack.craft, command.params[6]
    if command.frame in RELATIVE:
        return craft.home_z - altitude
    if command.frame in GLOBAL and command.frame not in AMSL:
        return -altitude
    return craft.z_of_altitude(altitude)


def _land(stack: Flight, command: Command) -> Result:
    """Obey NAV_LAND: land at the vehicle's present position."""
    return stack.request(Mode.LAND)


def _return(stack: Flight, command: Command) -> Result:
    """Obey NAV_RETURN_TO_LAUNCH: return home."""
    return stack.request(Mode.RTL)


def _start_mission(stack: Flight, command: Command) -> Result:
    """Obey MISSION_START: fly the mission, from an item if one is given; PX4 also arms."""
    first = _number(command.params[0], -1.0)
    if stack.plan.items and not -1.0 <= first < len(stack.plan.items):
        return Result.DENIED
    result = stack.request(Mode.MISSION)
    if result is not Result.ACCEPTED:
        return result
    if first > 0.0:
        stack.plan.set_current(int(first), stack.craft)
    # PX4 arms for it.
    return stack.arm()


def _set_mode(stack: Flight, command: Command) -> Result:
    """Obey DO_SET_MODE: switch to a flight mode, numbered as PX4 or ArduPilot does."""
    base, main, sub = (_number(value) for value in command.params[:3])
    if not int(base) & 1:
        return Result.UNSUPPORTED
    if not 0.0 <= main < 256.0 or not 0.0 <= sub < 256.0:
        return Result.DENIED
    return stack.request_number(stack.flavour.custom_of(int(main), int(sub)))


def _set_standard_mode(stack: Flight, command: Command) -> Result:
    """Obey DO_SET_STANDARD_MODE: switch to one of MAVLink's standard modes."""
    mode = stack.flavour.standard_mode(int(_number(command.params[0], -1.0)))
    return Result.FAILED if mode is None else stack.request(mode)


def _reposition(stack: Flight, command: Command) -> Result:
    """Obey DO_REPOSITION, in HOLD or if it asks to change to it: fly to a position within the fence and hold there."""
    craft, params = stack.craft, command.params
    if command.frame not in GLOBAL or not craft.seen.valid or craft.home is None:
        return Result.DENIED
    if not (stack.mode is Mode.HOLD or int(_number(params[1])) & 1):
        return Result.DENIED
    if not stack.armed:
        craft.say(Severity.CRITICAL, "Reposition rejected: not armed")
        return Result.TEMPORARILY_REJECTED
    goal = place_in(stack, command)
    if goal is None:
        return Result.DENIED
    if not craft.allows(goal):
        craft.say(Severity.CRITICAL, "Reposition is outside the fence")
        return Result.DENIED
    if all(map(math.isnan, params[4:7])):
        # Where it comes to rest: that is how ground stations pause.
        stack.guided, craft.critical = stack.flavour.name == "ardupilot", False
        stack.switch(Mode.HOLD)
        return Result.ACCEPTED
    if _number(params[0]) > 0.0:
        craft.cruise = params[0]
    craft.critical = False
    stack.guided = stack.flavour.name == "ardupilot"
    # From the ground it takes off first, to the height of its goal.
    stack.switch(Mode.HOLD, goal=goal)
    if not craft.flies:
        here = craft.seen.position_ned
        stack.switch(Mode.TAKEOFF, goal=(here[0], here[1], min(goal[2], here[2] - 0.5)))
    if math.isfinite(params[3]):
        craft.turn_to(_yaw(stack, params[3]))
    elif stack.mode is Mode.HOLD:
        craft.head_to(goal[0], goal[1], 2.0)
    return Result.ACCEPTED


def _orbit(stack: Flight, command: Command) -> Result:
    """Obey DO_ORBIT: circle a centre with a radius, speed and yaw behaviour; refused outside the fence and on the
    ground.

    Its altitude is above mean sea level in every frame, as PX4's MavlinkReceiver takes it: MAVSDK gives it one, in the
    frame of altitudes over home.
    """
    craft, params = stack.craft, command.params
    command = replace(command, frame=AMSL[0])
    if not craft.seen.valid or craft.home is None:
        return Result.DENIED
    if not (stack.armed and craft.flies):
        craft.say(Severity.CRITICAL, "Orbit command rejected: not in the air")
        return Result.TEMPORARILY_REJECTED
    centre = place_in(stack, command)
    if centre is None:
        return Result.DENIED
    orbit = copy(stack.orbit) if stack.mode is Mode.ORBIT else Orbit()
    orbit.ask(craft, centre, *params[:3])
    if not craft.allows(centre) or not fits(craft.fence, centre, orbit.radius):
        craft.say(Severity.CRITICAL, "Orbit command rejected: outside the fence")
        return Result.DENIED
    stack.orbit, stack.guided, craft.critical = orbit, False, False
    stack.switch(Mode.ORBIT)
    return Result.ACCEPTED


def _yaw(stack: Flight, value: float) -> float:
    """Return the heading [rad] from DO_REPOSITION's yaw parameter, in radians for PX4 and in degrees for ArduPilot."""
    return math.radians(value) if stack.flavour.name == "ardupilot" else value


def place_in(stack: Flight, command: Command) -> Triple | None:
    """Return the position NED [m] of a command, whose NaN coordinates mean the vehicle's own; None for an invalid
    position."""
    latitude, longitude, altitude = command.params[4:7]
    craft = stack.craft
    here = craft.seen.position_ned
    z = _z_of(stack, command) if math.isfinite(altitude) else here[2]
    if math.isnan(latitude) or math.isnan(longitude) or (latitude == 0.0 and longitude == 0.0):
        return here[0], here[1], z
    if abs(latitude) > 90.0 or abs(longitude) > 180.0 or abs(_number(altitude)) > LARGEST_ALTITUDE:
        return None
    level = craft.seen.altitude
    if math.isfinite(altitude):
        home = craft.home.altitude if craft.home else craft.geodesy.height
        level = altitude
        if command.frame not in AMSL:
            level += home if command.frame in RELATIVE else craft.geodesy.height
    return craft.geodesy.to_ned(latitude, longitude, level)


def _speed(stack: Flight, command: Command) -> Result:
    """Obey DO_CHANGE_SPEED: change the horizontal, climb or descent speed."""
    taken = change_speed(stack.craft, _number(command.params[0]), _number(command.params[1], -1.0))
    return Result.ACCEPTED if taken else Result.DENIED


def _heading(stack: Flight, command: Command) -> Result:
    """Obey CONDITION_YAW: turn to a heading [deg], absolute or relative."""
    angle, _, direction, relative = command.params[:4]
    if math.isnan(angle):
        return Result.DENIED
    stack.craft.turn_to(heading(stack.craft, angle, direction, relative))
    return Result.ACCEPTED


def _set_home(stack: Flight, command: Command) -> Result:
    """Obey DO_SET_HOME: move home to the vehicle's position or to a given one."""
    craft = stack.craft
    if _number(command.params[0]) >= 0.5:
        return Result.ACCEPTED if craft.home_here() else Result.DENIED
    latitude, longitude, altitude = command.params[4:7]
    if any(map(math.isnan, (latitude, longitude, altitude))) or (latitude == 0.0 and longitude == 0.0):
        return Result.DENIED
    if abs(latitude) > 90.0 or abs(longitude) > 180.0 or abs(altitude) > LARGEST_ALTITUDE:
        return Result.DENIED
    yaw = _number(command.params[3])
    place = craft.geodesy.to_ned(latitude, longitude, altitude)
    craft.set_home(Home(latitude, longitude, altitude, place, math.radians(yaw)))
    return Result.ACCEPTED


def _set_current(stack: Flight, command: Command) -> Result:
    """Obey DO_SET_MISSION_CURRENT: make a mission item the current one, with the results of PX4's Navigator or
    ArduPilot 4.8."""
    seq, reset = command.params[0], _number(command.params[1])
    if math.isnan(seq) or seq < -1.0 or seq != int(seq) or reset not in (0.0, 1.0):
        return Result.DENIED
    return Result.ACCEPTED if stack.plan.set_current(int(seq), stack.craft, reset == 1.0) else Result.FAILED


def _reboot(stack: Flight, command: Command) -> Result:
    """Obey PREFLIGHT_REBOOT_SHUTDOWN: restart the vehicle at its start; refused while it is armed."""
    if stack.armed:
        return Result.DENIED
    if _number(command.params[0]) not in (1.0, 3.0):
        return Result.ACCEPTED if _number(command.params[0]) == 0.0 else Result.UNSUPPORTED
    stack.craft.tell("reboot")
    return Result.ACCEPTED


def _inject(stack: Flight, command: Command) -> Result:
    """Obey INJECT_FAILURE, as PX4's failure_injection_manager does; refused unless SYS_FAILURE_EN is set."""
    craft = stack.craft
    if craft.injector is None:
        return Result.UNSUPPORTED
    if not stack.parameters["SYS_FAILURE_EN"]:
        craft.say(Severity.WARNING, "Failure injection is off: set SYS_FAILURE_EN to 1")
        return Result.DENIED
    unit, kind, number, mask = command.params[:4]
    instances = instances_of(number, mask)
    if instances is None:
        craft.say(Severity.WARNING, "Not injected: no such instance; allowed: 0 for all, to 16")
        return Result.DENIED
    if not (unit == _whole(unit) and kind == _whole(kind)):
        return Result.UNSUPPORTED
    result, text = craft.injector(int(unit), int(kind), instances, stack.parameters["BAT_CRIT_THR"])
    if text:
        craft.say(Severity.INFO if result is Result.ACCEPTED else Severity.WARNING, text)
    return result


def _whole(value: float) -> int:
    """Return a command parameter truncated to an integer; -1 for NaN."""
    return -1 if math.isnan(value) else int(value)


def _terminate(stack: Flight, command: Command) -> Result:
    """Obey DO_FLIGHTTERMINATION: stop the motors until a reboot."""
    if _number(command.params[0]) >= 0.5:
        stack.terminate()
    return Result.ACCEPTED


def _tell_home(stack: Flight, command: Command) -> Result:
    """Obey GET_HOME_POSITION: queue the message HOME_POSITION."""
    if stack.craft.home is None:
        return Result.TEMPORARILY_REJECTED
    stack.craft.tell("home")
    return Result.ACCEPTED


_COMMANDS: dict[int, Callable[[Flight, Command], Result]] = {
    20: _return, 21: _land, 22: _take_off, 34: _orbit, 115: _heading, 176: _set_mode, 178: _speed, 179: _set_home,
    185: _terminate, REPOSITION: _reposition, 224: _set_current, 246: _reboot, 262: _set_standard_mode,
    300: _start_mission, 400: _arm, 410: _tell_home, 420: _inject,
}  # fmt: skip
# Commands of one flavour.
_ONLY = {34: "px4", 115: "ardupilot", 262: "px4", 420: "px4"}
