"""What crashing, hovering and flying return in the simple tasks, and whether a return depends on the period.

The same seeds are flown with the throttle cut, by the hover command and by a small controller that sees what an agent
sees. And commands that change every half second are flown with an action every tick, and with longer steps.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.envs.batch import Batch

DOC = "returns of the simple tasks with the throttle cut, hovering and by a controller; and with other periods"
# Pitch, roll, throttle, yaw rate, battery in [-1, 1]; a throttle of 0.59 costs nothing and nearly hovers.
HOVER, CUT = np.array([0.0, 0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0, 0.0, 1.0])
TASKS = ("keep_spot", "goto_waypoint", "keep_velocity", "keep_spot_10")
SEEDS, SMALL_SEEDS = 100, 8
# Steps [s], the commands' own length last; how long they are flown.
PERIODS, LENGTH = (0.02, 0.1, 0.5), 5.0

Values = np.ndarray[Any, Any]


def run(full: bool) -> dict[str, Any]:
    """Return what each pilot's episodes return, and the largest difference that a period makes."""
    seeds = SEEDS if full else SMALL_SEEDS
    found: dict[str, Any] = {"seeds": seeds}
    for name in TASKS if full else TASKS[:1]:
        flown = Batch(name, seeds)
        totals = {pilot: fly(flown, command) for pilot, command in pilots(name).items()}
        found[name] = {pilot: told(*total) for pilot, total in totals.items()}
        found[name]["best_crash"] = max(t[~alive].max() for t, alive in totals.values() if not alive.all())
        found[name]["worst_survivor"] = min(t[alive].min() for t, alive in totals.values() if alive.any())
    for name in TASKS if full else TASKS[:1]:
        found[name]["period_apart"] = apart(name, PERIODS if full else PERIODS[::2])
    return found


def told(total: Values, alive: Values) -> dict[str, float]:
    """Return mean, smallest and largest return of episodes (B,), and the part flown to the end."""
    return {"mean": total.mean(), "low": total.min(), "high": total.max(), "flown_to_the_end": alive.mean()}


def pilots(name: str) -> dict[str, Any]:
    """Return what flies: a command, or a function of the step and of what is seen."""
    return {"cut": CUT, "hover": HOVER, "controller": lambda _, seen: controlled(name, seen)}


def fly(flown: Batch, command: Any, seed: int = 0) -> tuple[Values, Values]:
    """Return the mean returns (B,) of the agents, of the seeds from one on, and who flew to the end."""
    flown.reset(seed + np.arange(flown.size))
    shape = (flown.size, len(flown.functional.agents), flown.functional.play.width)
    total, alive = np.zeros(flown.size), np.ones(flown.size, bool)
    for step in range(flown.functional.play.steps):
        asked = command(step, flown.seen) if callable(command) else command
        reward, terminated, _ = flown.step(np.broadcast_to(asked, shape))
        total += np.where(alive, reward.mean(axis=1, dtype=np.float64), 0.0)
        alive &= ~terminated
        if not alive.any():
            break
    return total, alive


def controlled(name: str, seen: Values) -> Values:
    """Return commands (..., 5) of what is seen (..., 12): tilt by the error of a velocity towards the goal.

    Who is to keep a velocity of zero keeps its place too, because its area is small.
    """
    yaw, offset = seen[..., 8], seen[..., 9:12]
    if name == "keep_velocity":
        offset = np.array([0.0, 0.0, -10.0]) - seen[..., :3]
    lacking = np.clip(0.4 * offset, -3.0, 3.0) - seen[..., 3:6]
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead, right = cos * lacking[..., 0] + sin * lacking[..., 1], cos * lacking[..., 1] - sin * lacking[..., 0]
    tilt = np.clip(0.12 * np.stack([-ahead, right], axis=-1), -0.3, 0.3) / 0.9
    change = -0.1 * lacking[..., 2]
    throttle = change / np.where(change >= 0.0, 0.41, 0.59)
    parts = [*np.moveaxis(tilt, -1, 0), throttle, -0.2 * yaw / 4.5, np.ones_like(yaw)]
    return np.clip(np.stack(parts, axis=-1), -1.0, 1.0)


def changing(period: float) -> Any:
    """Return commands that change every half second: small tilts, turns and changes of the throttle."""
    longest = PERIODS[-1]
    drawn = np.random.default_rng(5).uniform(-1.0, 1.0, (round(LENGTH / longest), 5))
    drawn = drawn * [0.05, 0.05, 0.02, 0.1, 0.0] + HOVER
    steps = round(longest / period)
    return lambda step, _: drawn[step // steps]


def apart(name: str, periods: tuple[float, ...]) -> float:
    """Return the largest difference between the returns of one flight at several periods, in parts of the return."""
    totals = []
    for period in periods:
        flown = Batch(name, 4, [f"duration={LENGTH if name != 'keep_velocity' else 3.0}", f"task.period={period}"])
        total, alive = fly(flown, changing(period))
        if not alive.all():
            raise RuntimeError(f"{name}: a flight with changing commands ended early")
        totals.append(total)
    return float(np.max(np.ptp(totals, axis=0) / np.abs(totals[0])))
