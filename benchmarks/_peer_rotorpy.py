"""Flies rotorpy for peers.py; run by the Python of an environment that has it. Arguments: KIND VEHICLES SECONDS.

KIND 'single': one vehicle through rotorpy's own loop with its geometric controller, a constant wind, inertial and
motion capture sensors with noise. 'batched': many in one PyTorch batch, dynamics only, motor speeds held.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from _peer import timed

STEP = 0.01
STEPS = 50


def single() -> tuple[Callable[[], int], Callable[[], bool]]:
    """Return what flies one vehicle, and whether its state is finite."""
    from rotorpy.controllers.quadrotor_control import SE3Control
    from rotorpy.environments import Environment
    from rotorpy.simulate import simulate
    from rotorpy.trajectories.hover_traj import HoverTraj
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor
    from rotorpy.wind.default_winds import ConstantWind

    wind = ConstantWind(1.0, 0.5, 0.0)
    vehicle = Multirotor(quad_params)
    env = Environment(vehicle, SE3Control(quad_params), HoverTraj(), wind, sim_rate=round(1.0 / STEP))
    last: dict[str, Any] = {}

    def advance() -> int:
        found = simulate(
            env.world, vehicle.initial_state, vehicle, env.controller, env.trajectory, wind, env.imu, env.mocap,
            env.estimator, STEPS * STEP, STEP, env.safety_margin, False, terminate=False,
        )  # fmt: skip
        last.update(found[1])
        return len(found[0]) - 1

    return advance, lambda: bool(np.isfinite(last["x"]).all())


def batched(vehicles: int) -> tuple[Callable[[], int], Callable[[], bool]]:
    """Return what flies a batch, and whether its states are finite."""
    import torch
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import BatchedMultirotor, BatchedMultirotorParams

    device = torch.device("cpu")
    columns = {"x": 3, "v": 3, "q": 4, "w": 3, "wind": 3, "rotor_speeds": 4}
    state = {name: torch.zeros(vehicles, width).double() for name, width in columns.items()}
    state["q"][:, 3] = 1.0
    state["rotor_speeds"] += 1788.53
    params = BatchedMultirotorParams([quad_params] * vehicles, vehicles, device)
    fleet = BatchedMultirotor(params, vehicles, state, device, integrator="rk4")
    control = {"cmd_motor_speeds": torch.full((vehicles, 4), 1788.53).double()}

    def advance() -> int:
        nonlocal state
        with torch.no_grad():
            state = fleet.step(state, control, STEP)
        state["wind"] = torch.zeros(vehicles, 3).double()
        return vehicles

    return advance, lambda: bool(torch.isfinite(state["x"]).all())


def main() -> None:
    """Measure and print."""
    kind, vehicles, seconds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    advance, finite = single() if kind == "single" else batched(vehicles)
    timed(advance, STEP, seconds, finite)


if __name__ == "__main__":
    main()
