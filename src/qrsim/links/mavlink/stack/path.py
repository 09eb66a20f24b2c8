"""A point that moves to a goal with limited speed, acceleration and jerk, and that the vehicle follows."""

from __future__ import annotations

import math

from qrsim.links.mavlink.stack.contracts import Triple

# Wanted speed per metre to the goal [1/s], and acceleration per error of speed [1/s].
APPROACH, ANSWER = 0.8, 3.0
# Of the acceleration that the jerk could still end in time, what is asked for.
SOON = 0.8
# Of the largest acceleration, what braking counts on: the jerk's limit takes the rest.
BRAKING = 0.6
# Of a vehicle that is farther behind than the first [m] the point waits; it stands at the second more.
WAITS_FROM, WAITS_OVER = 2.0, 3.0
# Largest vertical acceleration of the point [m/s^2].
VERTICAL = 2.5
# Least speed on a line [m/s], and its least length [m].
SLOWEST, SHORTEST = 0.05, 0.01
# Velocity of a goal that stands.
STANDS: Triple = (0.0, 0.0, 0.0)


class Path:
    """The moving point of one vehicle.

    Attributes:
        position, velocity, acceleration: of the point, NED [m], [m/s], [m/s^2].
    """

    def __init__(self) -> None:
        self.position: Triple = (0.0, 0.0, 0.0)
        self.velocity: Triple = (0.0, 0.0, 0.0)
        self.acceleration: Triple = (0.0, 0.0, 0.0)

    def begin(self, position: Triple, velocity: Triple) -> None:
        """Put the path's point at a vehicle's position and velocity NED [m, m/s], unless it is already near them."""
        if math.dist(position, self.position) > 1.5 or math.dist(velocity, self.velocity) > 1.0:
            self.position, self.velocity, self.acceleration = position, velocity, (0.0, 0.0, 0.0)

    def shift(self, position: Triple) -> None:
        """Put the path's point at a position NED [m], at rest."""
        self.position, self.velocity, self.acceleration = position, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)

    def stop(self, most: float) -> Triple:
        """Return the position NED [m] where the path's point comes to rest if it brakes with at most ``most``
        [m/s^2]."""
        north, east, down = self.velocity
        way = braking_way(math.hypot(north, east), most)
        ratio = way / max(math.hypot(north, east), 1e-9)
        fall = math.copysign(braking_way(abs(down), VERTICAL), down)
        return self.position[0] + north * ratio, self.position[1] + east * ratio, self.position[2] + fall

    def move(
        self,
        goal: Triple,
        here: Triple,
        speeds: Triple,
        limits: tuple[float, float],
        dt: float,
        beyond: float = 0.0,
        along: Triple = STANDS,
        begin: Triple | None = None,
    ) -> None:
        """Move the path's point by one time step ``dt`` [s], to a goal NED [m] or along the line from ``begin`` to it.

        Off a line it returns to it: errors across the line are corrected before those along it.

        Args:
            goal: where it is to go [m].
            here: where the vehicle is, for which it waits [m].
            speeds: largest horizontal, upward and downward speed [m/s].
            limits: largest horizontal acceleration [m/s^2] and jerk [m/s^3].
            dt: step [s].
            beyond: how far beyond the goal the way goes on: so much later it brakes [m].
            along: velocity of the goal itself [m/s], without a line.
            begin: of the line [m]; None: there is no line.
        """
        behind = math.dist(here, self.position)
        rate = min(max(1.0 - (behind - WAITS_FROM) / WAITS_OVER, 0.0), 1.0)
        if begin is not None and math.dist(begin, goal) > SHORTEST:
            ax, ay, az = self._on_line(begin, goal, speeds, limits, limits[1] * dt, beyond, rate)
        else:
            ax, ay, az = self._to_goal(goal, speeds, limits, dt, beyond, along, rate)
        (vx, vy, vz), (px, py, pz) = self.velocity, self.position
        vx, vy, vz = vx + ax * dt, vy + ay * dt, vz + az * dt
        self.acceleration, self.velocity = (ax, ay, az), (vx, vy, vz)
        self.position = (px + vx * dt, py + vy * dt, pz + vz * dt)

    def _to_goal(
        self,
        goal: Triple,
        speeds: Triple,
        limits: tuple[float, float],
        dt: float,
        beyond: float,
        along: Triple,
        rate: float,
    ) -> Triple:
        """Return the acceleration [m/s^2] of the path's point towards a goal with velocity ``along``; ``rate``, 0 to 1,
        scales its speed."""
        px, py, pz = self.position
        vx, vy, vz = self.velocity
        ax, ay, az = self.acceleration
        dx, dy, dz = goal[0] - px, goal[1] - py, goal[2] - pz
        most, jerk = limits
        way = math.hypot(dx, dy)
        ratio = 0.0
        if way > 1e-6:
            speed = approach(way + beyond, BRAKING * most)
            ratio = (speed if speed < speeds[0] else speeds[0]) / way
        if ratio * dt > 1.0:
            # Never past the goal within a step.
            ratio = 1.0 / dt
        wx, wy = dx * ratio, dy * ratio
        if along != STANDS:
            wx, wy = wx + along[0], wy + along[1]
            ratio = min(1.0, speeds[0] / max(math.hypot(wx, wy), 1e-9))
            wx, wy = wx * ratio, wy * ratio
        bx, by = wx * rate - vx, wy * rate - vy
        size = math.hypot(bx, by)
        ratio = _answer(size, most, jerk) / size if size > 1e-9 else 0.0
        bx, by = bx * ratio, by * ratio
        bz = math.copysign(approach(abs(dz), BRAKING * VERTICAL), dz) + along[2]
        bz = min(max(bz, -speeds[1]), speeds[2]) * rate - vz
        bz = math.copysign(_answer(abs(bz), VERTICAL, jerk), bz)
        step = jerk * dt
        return ax + _within(bx - ax, step), ay + _within(by - ay, step), az + _within(bz - az, step)

    def _on_line(
        self,
        begin: Triple,
        goal: Triple,
        speeds: Triple,
        limits: tuple[float, float],
        step: float,
        beyond: float,
        rate: float,
    ) -> Triple:
        """Return the acceleration [m/s^2] of the path's point along the line ``begin`` to ``goal``; ``step``: its
        largest change, ``rate``: as in ``_to_goal``."""
        line = _minus(goal, begin)
        length = math.hypot(*line)
        unit = (line[0] / length, line[1] / length, line[2] / length)
        done = min(max(_dot(_minus(self.position, begin), unit), 0.0), length)
        nearest = (begin[0] + done * unit[0], begin[1] + done * unit[1], begin[2] + done * unit[2])
        level, rise = math.hypot(unit[0], unit[1]), abs(unit[2])
        vertical = speeds[1] if unit[2] < 0.0 else speeds[2]
        # The largest speed and acceleration along the line are those of the axis that reaches its limit first.
        most = 1.0 / max(level / limits[0], rise / VERTICAL)
        fastest = 1.0 / max(level / max(speeds[0], SLOWEST), rise / max(vertical, SLOWEST))
        speed = min(fastest, approach(length - done + beyond, BRAKING * most)) * rate
        beside = _minus(nearest, self.position)
        off = math.hypot(*beside)
        back = min(approach(off, BRAKING * most), fastest) * rate / max(off, 1e-9)
        moving = _dot(self.velocity, unit)
        across = [back * beside[i] - (self.velocity[i] - moving * unit[i]) for i in range(3)]
        size = math.hypot(*across)
        turn = _answer(size, most, limits[1])
        left = math.sqrt(max(most * most - turn * turn, 0.0))
        push = math.copysign(min(_answer(abs(speed - moving), most, limits[1]), left), speed - moving)
        asked = [push * unit[i] + turn * across[i] / max(size, 1e-9) - self.acceleration[i] for i in range(3)]
        share = min(1.0, step / max(math.hypot(*asked), 1e-9))
        ax, ay, az = self.acceleration
        return ax + asked[0] * share, ay + asked[1] * share, az + asked[2] * share


def approach(way: float, most: float) -> float:
    """Return the largest speed [m/s] at which braking with ``most`` [m/s^2] still stops within ``way`` [m]."""
    linear = most / (APPROACH * APPROACH)
    return APPROACH * way if way < linear else math.sqrt(2.0 * most * (way - 0.5 * linear))


def braking_way(speed: float, most: float) -> float:
    """Return the distance [m] needed to brake from a speed [m/s], at BRAKING times ``most`` [m/s^2]."""
    most *= BRAKING
    linear = most / (APPROACH * APPROACH)
    return speed / APPROACH if speed < APPROACH * linear else speed * speed / (2.0 * most) + 0.5 * linear


def _answer(error: float, most: float, jerk: float) -> float:
    """Return the acceleration [m/s^2] that removes a speed error [m/s], at most ``most`` [m/s^2], with a jerk limit
    [m/s^3]."""
    # Conditions, because the functions min and max take three times as long.
    found, soon = ANSWER * error, SOON * math.sqrt(2.0 * jerk * error)
    if soon < found:
        found = soon
    return most if most < found else found


def _within(value: float, limit: float) -> float:
    """Return a value clipped to [-limit, limit]."""
    return -limit if value < -limit else limit if value > limit else value


def _minus(end: Triple, begin: Triple) -> Triple:
    """Return the vector from ``begin`` to ``end``."""
    return end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]


def _dot(first: Triple, second: Triple) -> float:
    """Return the dot product of two vectors."""
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]
