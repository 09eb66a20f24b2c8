"""How well the controllers of docs/explanation/control_accuracy.md hold and follow.

Step responses: calm air, no noise, controllers fed with the truth; every response is a vehicle of its own, all in one
world. Holding and tracking: a mean wind of WIND [m/s] 20 ft above ground, full Dryden turbulence, noisy sensors, over
many seeds; the mean over the seeds has a Student t interval, and the band is that of single runs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

import qrsim
from evidence._plain_sensors import PLAIN
from qrsim.core.vectors import rotation
from qrsim.world.state import State

DOC = "step responses of every controller; hold and tracking error in wind with noisy sensors"
SEED = 20140915
CONFIDENCE = 0.95
HEIGHT = 20.0
STEP_S, SETTLED_S = 30.0, 10.0
WIND, FROM_DEG = 5.0, 225.0
# In wind: fleets, seeds, seconds left out at the start, seconds counted. Every fleet costs seconds to compile.
FULL = (("waypoint", "velocity", "velocity_height", "attitude_height"), 100, 20.0, 80.0)
SMALL = (("velocity_height",), 4, 5.0, 5.0)
TICKS_PER_SAMPLE, TICKS_PER_CHUNK = 5, 50

Values = np.ndarray[Any, Any]
QUIET = {"vehicle": {"type": "pelican", "process_noise": 0.0}}


def _row(first_north: float, count: int) -> list[list[float]]:
    """Return starts (count, 3) [m] so far apart that nobody meets."""
    return [[first_north, 150.0 * i, -HEIGHT] for i in range(count)]


def step_world(precision: str = "float32") -> qrsim.Simulation:
    """Return a calm world with a fleet for each controller."""
    sizes = {"waypoint": 4, "velocity": 4, "velocity_height": 3, "attitude_height": 3, "attitude": 2}
    fleets = {
        name: {**QUIET, "vehicles": _row(300.0 * i - 600.0, size), "controller": {"type": name, "feed": "truth"}}
        for i, (name, size) in enumerate(sizes.items())
    }
    area = {"type": "box", "x_min": -2000.0, "x_max": 2000.0, "y_min": -2000.0, "y_max": 2000.0, "z_min": -100.0}
    world = qrsim.make_world(fleets=fleets, area=area, duration=STEP_S, name="steps", precision=precision)
    return qrsim.Simulation(world, seed=SEED)


# For each fleet what its vehicles step in: (quantity, size of the step).
STEPS: dict[str, list[tuple[str, float]]] = {
    "waypoint": [("north", 5.0), ("east", 5.0), ("height", 3.0), ("yaw", math.pi / 2)],
    "velocity": [("velocity_north", 2.0), ("velocity_east", 2.0), ("climb", 1.0), ("yaw", math.pi / 2)],
    "velocity_height": [("velocity_north", 2.0), ("velocity_east", 2.0), ("height", 3.0)],
    "attitude_height": [("pitch", 0.1), ("roll", 0.1), ("height", 3.0)],
    "attitude": [("pitch", 0.1), ("roll", 0.1)],
}


def step_setpoints(starts: dict[str, Values]) -> dict[str, Any]:
    """Return the set-point of each fleet, for starts (n, 3) [m]."""

    def asked(fleet: str, quantity: str) -> Values:
        return np.array([size if name == quantity else 0.0 for name, size in STEPS[fleet]])

    def three(fleet: str, *names: str) -> Values:
        return np.stack([asked(fleet, name) for name in names], axis=-1)

    waypoint = starts["waypoint"] + three("waypoint", "north", "east", "height") * [1.0, 1.0, -1.0]
    velocity = three("velocity", "velocity_north", "velocity_east", "climb") * [1.0, 1.0, -1.0]
    level = three("velocity_height", "velocity_north", "velocity_east", "height")
    tilt = three("attitude_height", "roll", "pitch", "height")
    return {
        "waypoint": qrsim.WaypointSetpoint.of(waypoint, asked("waypoint", "yaw")),
        "velocity": qrsim.VelocitySetpoint.of(velocity, asked("velocity", "yaw")),
        "velocity_height": qrsim.VelocityHeightSetpoint.of(level[:, :2], -HEIGHT - level[:, 2]),
        "attitude_height": qrsim.AttitudeHeightSetpoint.of(tilt[:, 0], tilt[:, 1], -HEIGHT - tilt[:, 2]),
        "attitude": qrsim.AttitudeSetpoint.of(asked("attitude", "roll"), asked("attitude", "pitch"), 0.0, 0.6),
    }


def quantities(state: Values, velocity_ned: Values, start: Values) -> dict[str, Values]:
    """Return what steps, (T,) each, of positions and angles (T, 6), velocities (T, 3) and a start (3,)."""
    moved = state[:, :3] - start
    return {
        "north": moved[:, 0],
        "east": moved[:, 1],
        "height": -moved[:, 2],
        "velocity_north": velocity_ned[:, 0],
        "velocity_east": velocity_ned[:, 1],
        "climb": -velocity_ned[:, 2],
        "roll": state[:, 3],
        "pitch": state[:, 4],
        "yaw": state[:, 5],
    }


def response(time: Values, values: Values, size: float) -> dict[str, float]:
    """Return rise time (10 to 90 % of the step), overshoot and steady error, in per cent of the step.

    The steady error is that of the mean of the last SETTLED_S seconds, wanted minus actual; the overshoot is counted
    from the step's size, so that a response that settles below it has none.
    """
    reached = values / size
    first = [time[np.argmax(reached >= level)] if (reached >= level).any() else math.nan for level in (0.1, 0.9)]
    steady = float(reached[time > time[-1] - SETTLED_S].mean())
    found = {
        "overshoot_percent": max(0.0, 100.0 * (float(reached.max()) - 1.0)),
        "error_percent": 100.0 * (1.0 - steady),
    }
    # A response that never comes to 90 % has no rise time.
    return found if math.isnan(first[1]) else {"rise_s": float(first[1] - first[0]), **found}


def step_responses(precision: str = "float32") -> dict[str, Any]:
    """Return the response of each controller in each of its quantities."""
    simulation = step_world(precision)
    simulation.reset()
    start = simulation.truth.position_ned
    fleets = simulation.world.fleets
    bounds = np.cumsum([0, *(fleet.size for fleet in fleets)])
    slices = {fleet.name: slice(a, b) for fleet, a, b in zip(fleets, bounds[:-1], bounds[1:], strict=True)}
    setpoints = step_setpoints({name: start[part] for name, part in slices.items()})
    chunks = []
    for _ in range(round(STEP_S / simulation.world.time_step / TICKS_PER_CHUNK)):
        chunks.append(simulation.record(TICKS_PER_CHUNK, setpoints, TICKS_PER_CHUNK).state.fleets)
    if not simulation.valid.all():
        raise RuntimeError(f"a vehicle stopped: {simulation.reasons}")
    vehicles = [
        jax.tree.map(lambda *parts: np.concatenate(parts), *(c[i].vehicle for c in chunks)) for i in range(len(fleets))
    ]
    vehicle = jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *vehicles)
    time = simulation.world.time_step * np.arange(1, len(vehicle.thrust) + 1)
    state = np.stack(jax.tree.leaves((vehicle.position_ned, vehicle.attitude)), axis=-1)
    velocity = np.asarray(rotation(vehicle.attitude).to_ned(vehicle.velocity_body).stack())
    return {
        fleet: {
            name: response(time, quantities(state[:, i], velocity[:, i], start[i])[name], size)
            for i, (name, size) in enumerate(steps, slices[fleet].start)
        }
        for fleet, steps in STEPS.items()
    }


# In wind: vehicles, each with a task of its own. Those of one fleet share their controller.
TASKS = 6
SPEED, SIDE = 2.0, 40.0


def wind_world(fleets: Sequence[str], duration: float, precision: str = "float32") -> Any:
    """Return a windy world with a vehicle for each task of the fleets named."""
    starts = [[0.0, 400.0 * i - 1000.0, -HEIGHT] for i in range(TASKS)]
    loop = [[n, starts[1][1] + e, -HEIGHT] for n, e in ((SIDE, 0.0), (SIDE, SIDE), (0.0, SIDE), (0.0, 0.0))]

    def fleet(controller: str, *vehicles: Any, **more: Any) -> dict[str, Any]:
        control = {"type": controller, "tilt_limit": 0.6}
        return {"controller": control, "sensors": PLAIN, "vehicles": vehicles, **more}

    every = {
        "waypoint": fleet("waypoint", starts[0], {"position_ned": starts[1], "waypoints_ned": loop}),
        "velocity": fleet("velocity", *starts[2:4], guidance={"type": "velocity", "velocity_north": [0.0, SPEED]}),
        "velocity_height": fleet("velocity_height", starts[4]),
        "attitude_height": fleet("attitude_height", starts[5]),
    }
    area = {"type": "box", "x_min": -4000.0, "x_max": 4000.0, "y_min": -4000.0, "y_max": 4000.0, "z_min": -110.0}
    return qrsim.make_world(
        fleets={name: every[name] for name in fleets},
        area=area,
        duration=duration,
        name="windy",
        wind={"type": "log_shear", "speed_20ft": WIND, "wind_from_deg": FROM_DEG},
        turbulence="dryden",
        sky={"errors": "gauss_markov_2"},
        precision=precision,
    )


def _recorded(state: State) -> dict[str, Any]:
    def together(pick: Any) -> Any:
        return jax.tree.map(lambda *parts: jnp.concatenate(parts), *(pick(fleet) for fleet in state.fleets))

    vehicle = together(lambda fleet: fleet.vehicle)
    velocity = rotation(vehicle.attitude).to_ned(vehicle.velocity_body)
    return {"position": vehicle.position_ned.stack(), "velocity": velocity.stack()}


def errors_in_wind(fleets: Sequence[str], seeds: int, left_out: float, duration: float) -> dict[str, Any]:
    """Return the root mean square errors of each task over the seeds, and how many vehicles stopped."""
    world = wind_world(fleets, left_out + duration)
    ticks = round((left_out + duration) / world.time_step)
    flown = qrsim.rollout(
        world, ticks=ticks, seeds=range(SEED, SEED + seeds), record=_recorded, record_every=TICKS_PER_SAMPLE
    )
    counted = flown.record_ticks * world.time_step > left_out
    velocity = flown.recorded["velocity"][:, counted]
    offset = flown.recorded["position"][:, counted] - flown.recorded["position"][:, :1]
    first = dict(zip(fleets, np.cumsum([0, *(fleet.size for fleet in world.fleets)]), strict=False))

    def root_mean_square(values: Values) -> Values:
        return np.sqrt(np.mean(np.sum(np.square(values), axis=-1), axis=-1))

    found = {}
    if "waypoint" in first:
        hold, track = first["waypoint"], first["waypoint"] + 1
        found["waypoint_hold_horizontal_m"] = root_mean_square(offset[:, :, hold, :2])
        found["waypoint_hold_height_m"] = root_mean_square(offset[:, :, hold, 2:])
        found["waypoint_track_from_leg_m"] = flown["tracking_error_rms_m"][:, track]
    if "velocity" in first:
        hold, track = first["velocity"], first["velocity"] + 1
        found["velocity_hold_m_s"] = root_mean_square(velocity[:, :, hold])
        found["velocity_track_m_s"] = root_mean_square(velocity[:, :, track] - np.array([SPEED, 0.0, 0.0]))
    if "velocity_height" in first:
        hold = first["velocity_height"]
        found["velocity_height_hold_horizontal_m_s"] = root_mean_square(velocity[:, :, hold, :2])
        found["velocity_height_hold_height_m"] = root_mean_square(offset[:, :, hold, 2:])
    if "attitude_height" in first:
        found["attitude_height_height_m"] = root_mean_square(offset[:, :, first["attitude_height"], 2:])
    return {"stopped": int((flown["reason"] != 0).sum()), **{name: band(values) for name, values in found.items()}}


def band(values: Values) -> dict[str, float]:
    """Return mean with its Student t interval at CONFIDENCE, and the 5 and 95 % quantiles of single runs."""
    half = float(scipy.stats.t.ppf(0.5 + CONFIDENCE / 2, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values)))
    mean = float(values.mean())
    low, high = (float(q) for q in np.quantile(values, [0.05, 0.95]))
    return {"mean": mean, "low": mean - half, "high": mean + half, "run_5_percent": low, "run_95_percent": high}


def run(full: bool) -> dict[str, Any]:
    """Return the table of step responses and the errors in wind."""
    fleets, seeds, left_out, duration = FULL if full else SMALL
    return {
        "confidence": CONFIDENCE,
        "steps": step_responses(),
        "wind": {
            "seeds": seeds,
            "seconds": duration,
            "speed_20ft": WIND,
            **errors_in_wind(fleets, seeds, left_out, duration),
        },
    }
